"""Random streams: counter-based, so a draw depends on its key alone and never on what was drawn before.

A ``Stream`` belongs to one purpose in one step of one node and gives each particle its own numbers: the same whatever
the other particles draw, in whatever batches and on however many threads. ``Draws``, made by ``generator``, is for
draws that belong to no particle.
"""

import hashlib
import math
from functools import lru_cache
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynpf import kernels
from dynpf.portable import log
from dynpf.types import Float32s, FloatArray

__all__ = ["Draws", "Stream", "generator"]

Size = int | tuple[int, ...]
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


class Draws:
    """Numbers drawn one after another, the same on every machine: whole numbers and fractions are NumPy's.

    Not so its normal numbers and its uniform ones between bounds, which NumPy makes with functions of the C library and
    in one rounding or two, as the processor has it: those are made here.
    """

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator

    @overload
    def random(self) -> float: ...
    @overload
    def random(self, size: Size) -> FloatArray: ...
    def random(self, size: Size | None = None) -> float | FloatArray:
        """Return numbers uniform in [0, 1), multiples of 2**-53."""
        return self._generator.random(size)

    @overload
    def uniform(self, low: float = 0.0, high: float = 1.0) -> float: ...
    @overload
    def uniform(self, low: ArrayLike = 0.0, high: ArrayLike = 1.0, size: Size = ...) -> FloatArray: ...
    def uniform(self, low: ArrayLike = 0.0, high: ArrayLike = 1.0, size: Size | None = None) -> float | FloatArray:
        """Return numbers uniform in [low, high), which broadcast to ``size``; high only where rounding makes it so."""
        least, most = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        drawn = least + (most - least) * self._generator.random(size)
        return drawn if size is not None else float(drawn)

    @overload
    def standard_normal(self) -> float: ...
    @overload
    def standard_normal(self, size: Size) -> FloatArray: ...
    def standard_normal(self, size: Size | None = None) -> float | FloatArray:
        """Return standard normal numbers by Box and Muller's method; at most 8.6 from zero."""
        count = 1 if size is None else math.prod(size if isinstance(size, tuple) else (size,))
        pairs = (count + 1) // 2
        chances, turns = 1.0 - self._generator.random(pairs), self._generator.random(pairs)
        drawn = np.empty(2 * pairs)
        kernels.functions.normals(chances, turns, drawn)
        return float(drawn[0]) if size is None else drawn[:count].reshape(size)

    @overload
    def integers(self, low: int, high: int | None = None) -> int: ...
    @overload
    def integers(self, low: int, high: int | None = None, size: Size = ...) -> NDArray[np.int64]: ...
    def integers(self, low: int, high: int | None = None, size: Size | None = None) -> int | NDArray[np.int64]:
        """Return whole numbers in [low, high), in [0, low) without ``high``."""
        drawn = self._generator.integers(low, high, size)
        return int(drawn) if size is None else drawn

    def poisson(self, rate: float) -> int:
        """Return a number of events with a mean of ``rate``: as many as exponential waits fit into it."""
        count, waited = -1, 0.0
        while waited <= rate:
            waited -= log(1.0 - self._generator.random())
            count += 1
        return count

    def shares(self, count: int) -> FloatArray:
        """Return ``count`` shares of one, uniform over all ways to share it (Dirichlet with all parameters 1)."""
        waits = -log(1.0 - self._generator.random(count))
        shares: FloatArray = waits / np.sum(waits)
        return shares

    def permutation(self, values: ArrayLike) -> NDArray[Any]:
        """Return the values in any order; of a whole number, those below it."""
        return self._generator.permutation(values)

    def choice(self, values: ArrayLike, size: Size | None = None) -> Any:
        """Return one of the values, all equally likely, or as many as ``size`` says, each drawn by itself."""
        return self._generator.choice(values, size)


def generator(seed: int, node: str, step: int, purpose: str = "") -> Draws:
    """Return the draws of one purpose in one step of one node.

    Philox4x64 keyed by (seed, node) with the counter starting at (step, purpose): streams of different steps or
    purposes never overlap in fewer than 2**64 draws, and none carries state between steps.
    """
    key = np.array([seed & _WORD_64, _word(node.encode())], dtype=np.uint64)
    counter = np.array([0, 0, step, _word(purpose.encode())], dtype=np.uint64)
    return Draws(np.random.Generator(np.random.Philox(counter=counter, key=key)))


@lru_cache(maxsize=1024)
def _key(number: int, *names: str) -> int:
    return _word(number.to_bytes(8, "little") + "\0".join(names).encode()) & _POSITIVE


def _word(name: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(name, digest_size=8).digest(), "little")
