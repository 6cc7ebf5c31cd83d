"""COLON: a capsule in a tube whose walls change."""

from collections.abc import Iterator
from typing import Annotated

from dynpf_services.estimates import GAPS
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import FactKind, NodeKind, Take
from dynpf_services.scenario.schema import Scenario
from msgspec import Meta

from dynpf_systems.colon.config import CapsuleConfig, CapsuleEstimatorConfig, CapsuleSensorsConfig
from dynpf_systems.colon.tube import MOST_DRAWINGS, ColonConfig, colon_world

__all__ = ["CAPSULE", "COLON", "DRAWINGS", "ESTIMATOR", "RANGES"]

Drawings = Annotated[tuple[str, ...], Meta(max_length=MOST_DRAWINGS)]

COLON = FactKind(ColonConfig, about="The tube, and when its maps hold (COLON)", opened=colon_world)


def _take_drawing(path: str, _paths: tuple[str, ...], take: Take) -> None:
    take(path, path.rpartition("/")[2])


def _check_drawings(context: Context) -> None:
    if context.fact("maps"):
        colon_world(context).drawn()


def _without_tube(paths: tuple[str, ...], scenario: Scenario) -> Iterator[str]:
    if paths and "colon" not in scenario.facts:
        yield "maps: bitmaps for the tube of [colon], which this run lacks"


DRAWINGS = FactKind(
    Drawings,
    about="Bitmaps (PNG, BMP, PGM) that replace the tube of [colon]: a, b and so on in their order. Paths are relative"
    " to the scenario's folder, on the command line to the current one; a recording carries the content",
    files=lambda paths: paths,
    take=_take_drawing,
    bare=lambda paths: tuple(path.rpartition("/")[2] for path in paths),
    check=_check_drawings,
    problems=_without_tube,
    listed=True,
)

CAPSULE = NodeKind(
    config=CapsuleConfig,
    build="dynpf_systems.colon.simulator:build",
    reads=lambda *_: {"operator/place", "operator/map"},
    writes=lambda *_: {"truth/capsule", "truth/scene"},
)

RANGES = NodeKind(
    config=CapsuleSensorsConfig,
    build="dynpf_systems.colon.sensors:build",
    reads=lambda *_: {"truth/capsule"},
    writes=lambda *_: {"sensors/capsule"},
)

ESTIMATOR = NodeKind(
    config=CapsuleEstimatorConfig,
    build="dynpf_systems.colon.estimator:build",
    reads=lambda *_: {"sensors/capsule", GAPS},
    writes=lambda *_: (
        *(f"estimator/{name}" for name in ("capsule", "pose", "particles", "transforms", "scene")),
        "log",
    ),
)
