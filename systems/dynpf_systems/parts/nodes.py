"""PARTS: a robot that brings parts to their goals under an overhead camera."""

from collections.abc import Iterator

from dynpf_services.estimates import GAPS
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import FactKind, NodeKind, Surroundings

from dynpf_systems.parts.config import RearrangementConfig, WorkspaceConfig
from dynpf_systems.parts.controller_config import RearrangementControllerConfig
from dynpf_systems.parts.messages import PartsState
from dynpf_systems.parts.task import RearrangementTask, discs_of, walls_of
from dynpf_systems.parts.vision_config import VisionConfig

__all__ = ["CONTROLLER", "ESTIMATOR", "TASK", "VISION", "WORKSPACE"]

TASK = FactKind(
    RearrangementTask,
    about="Parts and their goals (PARTS)",
    surroundings=Surroundings(walls_of, "truth/parts", PartsState, discs_of),
)


def _without_task(_config: WorkspaceConfig, context: Context) -> Iterator[str]:
    if context.fact("task") is None:
        yield "task: missing; the workspace simulator needs the parts and their goals"


WORKSPACE = NodeKind(
    config=WorkspaceConfig,
    build="dynpf_systems.parts.simulator:build",
    reads=lambda *_: {"controller/command", "controller/parts"},
    writes=lambda *_: {"truth/robot", "truth/parts", "truth/scene", "camera/image"},
    problems=_without_task,
)

VISION = NodeKind(
    config=VisionConfig,
    build="dynpf_systems.parts.vision:build",
    reads=lambda *_: {"camera/image"},
    writes=lambda *_: {"vision/detections", "log"},
)

ESTIMATOR = NodeKind(
    config=RearrangementConfig,
    build="dynpf_systems.parts.estimator:build",
    reads=lambda *_: {
        *("vision/detections", "sensors/overhead", "sensors/gripper", "controller/command", "controller/parts"),
        GAPS,
    },
    writes=lambda *_: (*(f"estimator/{name}" for name in ("parts", "state", "pose", "particles", "transforms")), "log"),
)

CONTROLLER = NodeKind(
    config=RearrangementControllerConfig,
    build="dynpf_systems.parts.controller:build",
    reads=lambda *_: {"estimator/parts", "estimator/state"},
    writes=lambda *_: {"controller/parts", "controller/command"},
)
