"""Common parts of the parts studies: starts of trials, factors of their rows, and columns of their tables."""

from typing import Any, Literal, NamedTuple

from dynpf_experiments.rows import Row, Sample

from dynpf.rng import generator
from dynpf_systems.parts.config import FilterName

__all__ = ["FACTOR_COLUMNS", "GAUSSIAN", "Goals", "Parts", "Start", "run_seed", "samples_of"]

Goals = Literal["E", "I", "H"]
Parts = Literal[3, 6]

GAUSSIAN: tuple[FilterName, ...] = ("extended_kalman", "unscented_kalman")
"""Filters without particles."""

FACTOR_COLUMNS = tuple((name, "", name) for name in ("parts", "goals", "noise", "n", "filter"))


class Start(NamedTuple):
    """All runs of a trial with a layout of goals, as ``settings`` defines them."""

    layout: str
    seed: int
    trial: int
    settings: Any

    @property
    def factors(self) -> dict[str, int | str]:
        """The factors of the start's rows."""
        return {"parts": int(self.layout[0]), "goals": self.layout[1]}


def run_seed(seed: int, cell: str, trial: int) -> int:
    """Return the seed of a trial's runs in a cell of the study, which is the same for all filters."""
    return int(generator(seed, cell, trial).integers(2**62))


def samples_of(row: Row, samples: list[Sample]) -> list[dict[str, float | bool]]:
    """Return the measures of the samples with the factors of a row; goals "all" stands for any."""
    factors = [name for name in samples[0].factors if (name, row[name]) != ("goals", "all")]
    return [sample.measures for sample in samples if all(row[name] == sample.factors[name] for name in factors)]
