"""Random streams: counter-based, so a draw depends on its key alone and never on what was drawn before."""

import hashlib

import numpy as np

__all__ = ["stream"]


def stream(seed: int, node: str, step: int, purpose: str = "") -> np.random.Generator:
    """Return the generator for one purpose in one step of one node.

    Philox (Salmon et al., 2011) keyed by (seed, node) with the counter starting at (step, purpose): streams of
    different steps or purposes never overlap in fewer than 2**64 draws, and none carries state between steps.
    """
    key = np.array([seed & (2**64 - 1), _word(node)], dtype=np.uint64)
    counter = np.array([0, 0, step, _word(purpose)], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(counter=counter, key=key))


def _word(name: str) -> int:
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
