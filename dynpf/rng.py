"""Random streams: counter-based, so a draw depends on its key alone and never on what was drawn before.

A ``Stream`` belongs to one purpose in one step of one node and gives each particle its own numbers: the same whatever
the other particles draw, in whatever batches and on however many threads. ``generator`` is NumPy's, for draws that
belong to no particle.
"""

import hashlib
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynpf import kernels

__all__ = ["Stream", "generator"]

Float32s = NDArray[np.float32]
# Kernels take both numbers of a stream as signed words.
_POSITIVE = 2**63 - 1
_WORD_64 = 2**64 - 1


class Stream(NamedTuple):
    """Philox4x32-10 (Salmon et al., 2011): ``key`` stands for seed, node and purpose; the counter is (particle, step).

    ``first`` is the number of the particle that the first column of a draw belongs to.
    """

    key: int
    step: int
    first: int = 0

    @classmethod
    def of(cls, seed: int, node: str, step: int, purpose: str = "") -> "Stream":
        """Return the stream of one purpose in one step of one node; the seed counts modulo 2**64, the step 2**63."""
        return cls(_key(seed & _WORD_64, node, purpose), step & _POSITIVE)

    def part(self, purpose: str | int) -> "Stream":
        """Return a stream for a part of this one's purpose, independent of it: use a stream for one draw only."""
        return Stream(_key(self.key, "\0part", str(purpose)), self.step, self.first)

    def starting_at(self, particle: int) -> "Stream":
        """Return the stream of the particles from ``particle`` on."""
        return Stream(self.key, self.step, self.first + particle)

    def normals(self, rows: int, count: int) -> Float32s:
        """Return standard normal numbers, shape (rows, count), a column a particle; at most 6.7 from zero."""
        drawn = np.empty((rows, count), dtype=np.float32)
        kernels.philox.fill_normals(drawn, self.first, self.step, self.key)
        return drawn

    def uniforms(self, rows: int, count: int) -> Float32s:
        """Return numbers uniform in [0, 1), multiples of 2**-24, shape (rows, count), a column a particle."""
        drawn = np.empty((rows, count), dtype=np.float32)
        kernels.philox.fill_uniforms(drawn, self.first, self.step, self.key)
        return drawn

    def fine_uniforms(self, count: int) -> NDArray[np.float64]:
        """Return numbers uniform in [0, 1), multiples of 2**-48, shape (count,), one a particle."""
        high, low = self.uniforms(2, count).astype(np.float64)
        fine: NDArray[np.float64] = high + low * 2.0**-24
        return fine

    def uniform(self) -> float:
        """Return one number uniform in [0, 1), a multiple of 2**-53: the draw of a comb, which no particle owns."""
        high, low = kernels.philox.two_words(self.first, self.step, self.key)
        return float(high >> 5) * 2.0**-27 + float(low >> 6) * 2.0**-53


def generator(seed: int, node: str, step: int, purpose: str = "") -> np.random.Generator:
    """Return NumPy's generator for one purpose in one step of one node.

    Philox4x64 keyed by (seed, node) with the counter starting at (step, purpose): streams of different steps or
    purposes never overlap in fewer than 2**64 draws, and none carries state between steps.
    """
    key = np.array([seed & _WORD_64, _word(node.encode())], dtype=np.uint64)
    counter = np.array([0, 0, step, _word(purpose.encode())], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(counter=counter, key=key))


@lru_cache(maxsize=1024)
def _key(number: int, *names: str) -> int:
    return _word(number.to_bytes(8, "little") + "\0".join(names).encode()) & _POSITIVE


def _word(name: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(name, digest_size=8).digest(), "little")
