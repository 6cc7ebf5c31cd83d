"""Twin of ``dynpf.kernels.philox``: Philox4x32-10 (Salmon et al., 2011) and Box and Muller's transform."""

import numpy as np
from numpy.typing import NDArray

from dynpf.types import FloatArray

__all__ = ["normals", "uniforms", "words"]

Words = NDArray[np.uint64]

_MULTIPLIERS = 0xD2511F53, 0xCD9E8D57
_WEYL = 0x9E3779B9, 0xBB67AE85
_LOW = np.uint64(0xFFFFFFFF)


def words(counter: Words, key: tuple[int, int]) -> Words:
    """Return the words (4, N) below 2**32 of counters (4, N) under a key of two words."""
    c = counter.astype(np.uint64)
    for number in range(10):
        k = [np.uint64((word + number * weyl) & 0xFFFFFFFF) for word, weyl in zip(key, _WEYL, strict=True)]
        products = np.uint64(_MULTIPLIERS[0]) * c[0], np.uint64(_MULTIPLIERS[1]) * c[2]
        high, low = [product >> np.uint64(32) for product in products], [product & _LOW for product in products]
        c = np.stack((high[1] ^ c[1] ^ k[0], low[1], high[0] ^ c[3] ^ k[1], low[0]))
    return c


def uniforms(shape: tuple[int, int], first: int, step: int, key: int) -> FloatArray:
    """Return the numbers of ``fill_uniforms``: the upper 24 bits of each word as a fraction of one."""
    return (_rows(shape, first, step, key) >> np.uint64(8)) / 2.0**24


def normals(shape: tuple[int, int], first: int, step: int, key: int) -> FloatArray:
    """Return the numbers of ``fill_normals`` in float64."""
    rows, count = shape
    drawn = _rows((rows + rows % 2, count), first, step, key)
    # The kernel rounds the 31 upper bits to float32 before it adds a half, and the product once more.
    chance = ((drawn[0::2] >> np.uint64(1)).astype(np.float32) + np.float32(0.5)) * np.float32(2.0**-31)
    turn = (drawn[1::2] >> np.uint64(8)) / 2.0**24
    radius = np.sqrt(-2.0 * np.log(chance.astype(np.float64)))
    pairs = np.stack((radius * np.cos(2.0 * np.pi * turn), radius * np.sin(2.0 * np.pi * turn)), axis=1)
    return pairs.reshape(-1, count)[:rows]


def _rows(shape: tuple[int, int], first: int, step: int, key: int) -> Words:
    """Return the words (R, N): word r % 4 of draw r // 4 of particle first + i."""
    rows, count = shape
    counter = np.empty((4, count), dtype=np.uint64)
    counter[0] = np.arange(first, first + count, dtype=np.uint64) & _LOW
    counter[2:] = np.array([[step & 0xFFFFFFFF], [step >> 32]], dtype=np.uint64)
    drawn = []
    for draw in range(-(-rows // 4)):
        counter[1] = draw
        drawn.append(words(counter, (key & 0xFFFFFFFF, key >> 32)))
    return np.concatenate(drawn)[:rows]
