// The time that a page shows, and how it goes on; moments are the times of the slider, ascending.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100];

/** Return the speed at which a run of so many seconds is over in about half a minute, at least 1. */
export function usualSpeed(seconds) {
  return SPEEDS.find((speed) => speed >= 1 && speed * 40 >= seconds) ?? SPEEDS.at(-1);
}

/** Return a speed so many steps from another. */
export function nextSpeed(speed, steps) {
  const index = SPEEDS.indexOf(speed) + steps;
  return SPEEDS[Math.min(Math.max(index, 0), SPEEDS.length - 1)];
}

/** Return the time after elapsed seconds of a viewer's, and whether the run goes on. */
export function advanced(t, elapsed, speed, end) {
  const next = t + elapsed * speed;
  return next >= end ? { t: end, playing: false } : { t: next, playing: true };
}

/** Return the times of several runs as one, ascending, each once. */
export function merged(lists) {
  const all = lists.flatMap((times) => Array.from(times)).sort((a, b) => a - b);
  return Float64Array.from(all.filter((time, index) => index === 0 || time > all[index - 1]));
}

/** Return a time in words: seconds, above two minutes with minutes. */
export function words(t) {
  if (t < 120) return `${t.toFixed(2)} s`;
  const minutes = Math.floor(t / 60);
  return `${minutes} min ${(t - 60 * minutes).toFixed(1).padStart(4, "0")} s`;
}
