"""PARTS: a robot that brings parts to their goals under an overhead camera."""

from collections.abc import Iterator

import numpy as np
from dynpf_services.estimates import GAPS
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.kinds import FactKind, NodeKind, Surroundings

from dynpf.vision import Board
from dynpf_systems.parts.camera_model import project
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
MISCALIBRATED_PX = 5.0
"""Greatest distance of a calibration's points from their projections by the simulated camera: an error of measuring."""


def _without_task(_config: WorkspaceConfig, context: Context) -> Iterator[str]:
    if context.fact("task") is None:
        yield "task: missing; the workspace simulator needs the parts and their goals"


WORKSPACE = NodeKind(
    config=WorkspaceConfig,
    build="dynpf_systems.parts.simulator:build",
    reads=lambda *_: {"controller/command", "controller/parts", "operator/move", "operator/place", "operator/body"},
    writes=lambda *_: {"truth/robot", "truth/parts", "truth/scene", "camera/image"},
    problems=_without_task,
)


def _miscalibrated(config: VisionConfig, context: Context) -> Iterator[str]:
    key = f"{context.name}.calibration"
    if config.calibration is None:
        yield (
            f"{key}: missing; write known points as [[u_px, v_px, x_m, y_m], ...], 6 at least, or "
            '{ kind = "board" } and the same for simulator.camera.board'
        )
    world = context.beside("simulator")
    camera = world.camera if isinstance(world, WorkspaceConfig) else None
    if camera is None or config.calibration is None:
        return
    if isinstance(config.calibration, Board):
        if camera.board != config.calibration:
            shown = "none" if camera.board is None else "another"
            yield f"{key}: a board, but simulator.camera.board shows {shown}; give both the same"
        return
    pairs = np.array(config.calibration)
    away = float(np.max(np.abs(project(pairs[:, 2:], camera) - pairs[:, :2])))
    if away > MISCALIBRATED_PX:
        yield (
            f"{key}: its points lie up to {away:.1f} px from where simulator.camera sees them, expected at most "
            f"{MISCALIBRATED_PX:g} px; write those of this camera (docs/vision.md), or use a board"
        )


VISION = NodeKind(
    config=VisionConfig,
    build="dynpf_systems.parts.vision:build",
    reads=lambda *_: {"camera/image"},
    writes=lambda *_: {"vision/detections", "log"},
    problems=_miscalibrated,
)

ESTIMATOR = NodeKind(
    config=RearrangementConfig,
    build="dynpf_systems.parts.estimator:build",
    reads=lambda *_: {
        *("vision/detections", "sensors/overhead", "sensors/gripper", "controller/command", "controller/parts"),
        GAPS,
    },
    writes=lambda *_: (
        *(f"estimator/{name}" for name in ("parts", "identities", "state", "pose", "particles", "transforms")),
        "log",
    ),
)

CONTROLLER = NodeKind(
    config=RearrangementControllerConfig,
    build="dynpf_systems.parts.controller:build",
    reads=lambda *_: {"estimator/parts", "estimator/identities", "estimator/state", "sensors/gripper"},
    writes=lambda *_: {"controller/parts", "controller/command", "log"},
)
