// Reads the packed numbers of a page: what dynpf_experiments.pictures.columns writes.

const HALF_STEP = 5e-4; // s; times are rounded to milliseconds

/** Return a column of numbers {q, d}: multiples of q, told as the first and then differences; NaN where null.
 *  Numbers that are a plain list already stay as they are. */
export function column(packed) {
  if (Array.isArray(packed)) return packed;
  const values = new Float64Array(packed.d.length);
  let steps = 0;
  packed.d.forEach((difference, index) => {
    if (difference === null) {
      values[index] = NaN;
    } else {
      steps += difference;
      values[index] = steps * packed.q;
    }
  });
  return values;
}

/** Return sets of points, each as x0, y0, x1, y1, ...: 16-bit offsets from each set's middle. */
export function points(packed) {
  const bytes = Uint8Array.from(atob(packed.b), (character) => character.charCodeAt(0));
  const offsets = new DataView(bytes.buffer);
  const [x, y] = [column(packed.x), column(packed.y)];
  let at = 0;
  return packed.n.map((count, index) => {
    const found = new Float64Array(2 * count);
    for (let number = 0; number < 2 * count; number += 1, at += 2) {
      const middle = number % 2 ? y[index] : x[index];
      found[number] = middle + packed.q * offsets.getInt16(at, true);
    }
    return found;
  });
}

/** Return the cells of a map, row by row from the bottom: 0 free, 1 occupied, 2 unknown. */
export function cells(packed) {
  const found = new Uint8Array(packed.w * packed.h);
  let at = 0;
  for (const run of packed.runs) {
    const length = run >> 2;
    found.fill(run & 3, at, at + length);
    at += length;
  }
  return found;
}

/** Return the index of the last of ascending times that is not after t, -1 before the first. */
export function held(times, t) {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t + HALF_STEP) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}
