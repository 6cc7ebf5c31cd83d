"""What the parts studies share: starts of trials, factors of their rows, and columns of their tables."""

from typing import Any, Literal, NamedTuple

from dynpf_experiments.rows import Row, Sample

from dynpf.rng import generator
from dynpf.types import Count
from dynpf_systems.parts.config import FilterName

__all__ = ["FACTOR_COLUMNS", "GAUSSIAN", "Count", "Goals", "Noisy", "Parts", "Start", "run_seed", "samples_of"]

Goals = Literal["E", "I", "H"]
Noisy = Literal["low", "medium", "high"]
Parts = Literal[3, 6]

GAUSSIAN: tuple[FilterName, ...] = ("extended_kalman", "unscented_kalman")
"""Filters without particles."""

FACTOR_COLUMNS = tuple((name, "", name) for name in ("parts", "goals", "noise", "n", "filter"))


class Start(NamedTuple):
    """All runs of one trial with one layout of goals: ``settings`` says which."""

    layout: str
    seed: int
    trial: int
    settings: Any

    @property
    def factors(self) -> dict[str, int | str]:
        return {"parts": int(self.layout[0]), "goals": self.layout[1]}


def run_seed(seed: int, cell: str, trial: int) -> int:
    """Return the seed of a trial's runs in a cell of the study, whatever the filter."""
    return int(generator(seed, cell, trial).integers(2**62))


def samples_of(row: Row, samples: list[Sample]) -> list[dict[str, float | bool]]:
    """Return what the samples measured that a row sums up: those under its factors, of any goals where it says all."""
    factors = [name for name in samples[0].factors if (name, row[name]) != ("goals", "all")]
    return [one.measures for one in samples if all(row[name] == one.factors[name] for name in factors)]
