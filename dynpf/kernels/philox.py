"""Philox4x32-10 (Salmon et al., 2011): four random words from a key and a counter, no state between calls.

The key has two words. The counter is (particle, draw, low word of the step, high word of the step).
"""

import numpy as np

from dynpf.kernels.compiler import device, kernel
from dynpf.kernels.elementary import log, sincos

__all__ = ["BLOCK", "fill_normals", "fill_uniforms", "two_words", "words"]

BLOCK = 256
"""Particles to a block: what a block needs stays in the fastest cache."""

_u = np.uint32
_MULTIPLIER_0, _MULTIPLIER_1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL_0, _WEYL_1 = _u(0x9E3779B9), _u(0xBB67AE85)
_LOW, _WORD = np.uint64(0xFFFFFFFF), np.uint64(32)
_f = np.float32
_UNIT_24, _UNIT_31 = _f(2.0**-24), _f(2.0**-31)
_TWO_PI, _MINUS_TWO, _HALF = _f(2.0 * np.pi), _f(-2.0), _f(0.5)


@device
def words(particle, draw, step_low, step_high, key_low, key_high):
    """Return the four words of a counter under a key."""
    c0, c1, c2, c3 = _u(particle), _u(draw), _u(step_low), _u(step_high)
    k0, k1 = _u(key_low), _u(key_high)
    for _ in range(10):
        product_0 = _MULTIPLIER_0 * np.uint64(c0)
        product_1 = _MULTIPLIER_1 * np.uint64(c2)
        c0, c1, c2, c3 = (
            _u(_u(product_1 >> _WORD) ^ c1 ^ k0),
            _u(product_1 & _LOW),
            _u(_u(product_0 >> _WORD) ^ c3 ^ k1),
            _u(product_0 & _LOW),
        )
        k0 = _u(k0 + _WEYL_0)
        k1 = _u(k1 + _WEYL_1)
    return c0, c1, c2, c3


@device
def box_muller(for_radius, for_angle, cosines, sines):
    """Fill ``cosines`` and ``sines`` (n,) with independent standard normal numbers, made of two words each pair."""
    for i in range(cosines.size):
        # Half a unit is added, so that the logarithm never meets zero.
        chance = (_f(np.int32(for_radius[i] >> _u(1))) + _HALF) * _UNIT_31
        turn = _f(np.int32(for_angle[i] >> _u(8))) * _UNIT_24
        radius = np.sqrt(_MINUS_TWO * log(chance))
        sine, cosine = sincos(turn * _TWO_PI)
        cosines[i] = radius * cosine
        sines[i] = radius * sine


@kernel
def fill_normals(out, first, step, key):
    """Fill ``out`` (R, N): row r of column i is number r % 4 of draw r // 4 of particle first + i.

    The words come first, in a loop of their own: both loops then become vectors.
    """
    rows, count = out.shape
    step, key = np.uint64(step), np.uint64(key)
    drawn = np.empty((4, BLOCK), dtype=np.uint32)
    unwanted = np.empty(BLOCK, dtype=np.float32)
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        for row in range(0, rows, 4):
            for i in range(size):
                drawn[0, i], drawn[1, i], drawn[2, i], drawn[3, i] = words(
                    first + start + i, row // 4, step, step >> _WORD, key, key >> _WORD
                )
            for pair in range(0, min(4, rows - row), 2):
                cosines = out[row + pair, start : start + size]
                sines = out[row + pair + 1, start : start + size] if row + pair + 1 < rows else unwanted[:size]
                box_muller(drawn[pair], drawn[pair + 1], cosines, sines)


@kernel
def fill_uniforms(out, first, step, key):
    """Fill ``out`` (R, N) from words as ``fill_normals`` does, the upper 24 bits of each as a fraction of one."""
    rows, count = out.shape
    step, key = np.uint64(step), np.uint64(key)
    for row in range(0, rows, 4):
        for i in range(count):
            drawn = words(first + i, row // 4, step, step >> _WORD, key, key >> _WORD)
            for r in range(min(4, rows - row)):
                out[row + r, i] = _f(np.int32(drawn[r] >> _u(8))) * _UNIT_24


@kernel
def two_words(first, step, key):
    """Return the first two words of one particle's counter."""
    step, key = np.uint64(step), np.uint64(key)
    drawn = words(first, 0, step, step >> _WORD, key, key >> _WORD)
    return drawn[0], drawn[1]
