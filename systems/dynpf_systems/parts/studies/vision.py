"""PARTS with a camera: the accuracy of the detection of discs, and the task executed from camera frames only."""

from pathlib import Path
from typing import Any, NamedTuple, get_args

import cv2
import msgspec
import numpy as np
from dynpf_experiments.drive import drive
from dynpf_experiments.messages import RunMessages, of_type
from dynpf_experiments.rows import Row, Sample, summarized
from dynpf_experiments.study import Study
from dynpf_protocol.errors import UsageError
from dynpf_protocol.messages import CompressedImage, Log, timestamp
from dynpf_runtime.node import Received, Step
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario
from numpy.typing import NDArray

from dynpf.rng import generator
from dynpf.types import Count
from dynpf.vision import Board, DetectionParams, detect_discs
from dynpf_systems.parts.camera import CAMERA_FRAME, DrawnDisc, board_discs, encode, render
from dynpf_systems.parts.camera_model import CameraParams
from dynpf_systems.parts.config import WorkspaceConfig
from dynpf_systems.parts.measures import TOPICS, course_of, rearrangement
from dynpf_systems.parts.messages import Detections
from dynpf_systems.parts.simulator import draw_starts
from dynpf_systems.parts.studies.disc_scenes import KINDS, draw_scene, score
from dynpf_systems.parts.studies.runs import LAYOUTS, RADII, layout_task
from dynpf_systems.parts.studies.trials import Goals
from dynpf_systems.parts.task import NoiseLevel, NoisyLevel
from dynpf_systems.parts.vision import SUBSAMPLING, VisionNode
from dynpf_systems.parts.vision_config import VisionConfig

__all__ = ["CAMERAS", "PHOTOGRAPH", "STUDY", "VisionSettings", "calibrated_node", "frame_errors", "photograph"]

SCENARIO = "parts-3-lens"
"""The scenario of the runs: its lens distorts, its light is uneven, and it is calibrated from a board."""

_LENS = -0.15
CAMERAS = {
    name: CameraParams(radial_distortion=lens, light_falloff=falloff, light_slope=slope, board=Board())
    for name, lens, falloff, slope in (
        ("plain", 0.0, 0.0, 0.0),
        ("lens", _LENS, 0.0, 0.0),
        ("light", 0.0, 0.35, 0.3),
        ("lens and light", _LENS, 0.35, 0.3),
    )
}
"""The cameras of single frames; the last is the scenario's."""
FRAMES = 5  # for each trial and camera
SCENES = 5  # for each trial and kind
_SAME_M = 0.02  # m, greatest error of position or radius at which a detection matches a disc

PHOTOGRAPH = DetectionParams(max_radius_px=60.0)


class VisionSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The layouts, the noise levels, and which frames and photographs are analysed."""

    goals: tuple[Goals, ...] = ("E", "I", "H")
    noises: tuple[NoiseLevel, ...] = get_args(NoisyLevel)  # added to the detections
    n: Count = 100
    ticks: Count = 6000  # after which a run is given up
    frames: bool = True  # also single frames of four cameras, and drawn scenes
    photographs: tuple[str, ...] = ()  # image files to look for discs in


class _Run(NamedTuple):
    goals: Goals
    noise: NoiseLevel
    n: int
    ticks: int
    seed: int
    trial: int


class _Frames(NamedTuple):
    camera: str
    seed: int
    trial: int


class _Scenes(NamedTuple):
    kind: str
    seed: int
    trial: int


class _Photograph(NamedTuple):
    path: str


def _parts(settings: VisionSettings, trials: int, seed: int) -> list[Any]:
    parts: list[Any] = [
        _Run(goals, noise, settings.n, settings.ticks, seed, trial)
        for trial in range(trials)
        for goals in settings.goals
        for noise in settings.noises
    ]
    if settings.frames:
        parts += [_Frames(camera, seed, trial) for camera in CAMERAS for trial in range(trials)]
        parts += [_Scenes(kind, seed, trial) for kind in KINDS for trial in range(trials)]
    return parts + [_Photograph(path) for path in settings.photographs]


def _run_part(part: Any) -> list[Sample]:
    cv2.setNumThreads(1)
    match part:
        case _Run():
            return [_run(part)]
        case _Frames():
            return [_look(part)]
        case _Scenes():
            return [_look_at_scenes(part)]
        case _:
            discs = detect_discs(photograph(part.path), PHOTOGRAPH)
            return [Sample({"view": Path(part.path).name}, {"discs": float(len(discs))})]


def _rows(samples: list[Sample]) -> list[Row]:
    runs = [sample for sample in samples if "goals" in sample.factors]
    rows = summarized(runs, "goals")
    views: dict[str, list[Sample]] = {}  # measures differ between views, so views are not pooled
    for sample in samples:
        if "view" in sample.factors:
            views.setdefault(sample.factors["view"], []).append(sample)
    return rows + [summarized(some, "view")[0] for some in views.values()]


# The task in the loop.


def _run(part: _Run) -> Sample:
    """Run the scenario to its end and return its measures."""
    scenario = _scenario(part)
    factors = {"parts": 3, "goals": part.goals, "noise": part.noise, "n": part.n}
    return Sample(factors, _measures(drive(scenario, (*TOPICS, "vision/detections"))))


def _scenario(part: _Run) -> Scenario:
    layout = f"3{part.goals}"
    parts = ", ".join(
        f"{{ radius = {radius}, goal = [{x}, {y}] }}" for radius, (x, y) in zip(RADII[3], LAYOUTS[layout], strict=True)
    )
    overrides = (
        f"task.parts=[{parts}]",
        f"task.noise={part.noise}",
        f"estimator.n={part.n}",
        f"max_ticks={part.ticks}",
    )
    seed = int(generator(part.seed, f"{layout} vision", part.trial).integers(2**31))
    return load_scenario(SCENARIO, overrides=overrides, seed=seed)


def _measures(run: RunMessages) -> dict[str, float | bool]:
    """Return the measures of a run; those of vision without the first tick, whose frame shows the board."""
    course = course_of(run)
    assert course is not None
    found = rearrangement(course)
    truth = {
        timed.stamp_ns: np.vstack([parts, robot])
        for timed, parts, robot in zip(run.topic("truth/parts"), course.parts, course.robot, strict=True)
    }
    seen = run.topic("vision/detections")[1:]
    missed, distances = 0, []
    for timed, detections in zip(seen, of_type(seen, Detections), strict=True):
        positions = truth[timed.stamp_ns]
        discs = np.array([(disc.x, disc.y) for disc in detections.discs]).reshape(-1, 2)
        missed += max(len(positions) - len(discs), 0)
        distances += np.hypot(*(discs[:, None] - positions).transpose(2, 0, 1)).min(axis=1).tolist()
    return {
        "completed_25mm_percent": found["completed"],
        "collided_percent": course.contacts > 0,
        "npl": found["npl"],
        "nrl": found["nrl"],
        "pi": found["pi"],
        "final_error_mean_cm": 100.0 * found["final_error_mean_m"],
        "final_error_max_cm": 100.0 * found["final_error_max_m"],
        "rpee_cm": 100.0 * found["rpee_m"],
        "ppee_cm": 100.0 * found["ppee_m"],
        "centre_error_mm": 1000.0 * float(np.sqrt(np.square(distances).mean())),
        "missed_discs_percent": 100.0 * missed / max(len(seen) * (len(course.goals) + 1), 1),
        "ticks": float(len(course.parts)),
    }


# Single frames.


def calibrated_node(camera: CameraParams, seed: int) -> VisionNode:
    """Return a vision node calibrated from the board; raises UsageError if it did not find the board."""
    node = VisionNode(config=VisionConfig(calibration=Board()), seed=seed)
    assert camera.board is not None
    _, message = _shown(node, render(board_discs(camera.board, camera), camera, seed, 0), camera, 0)
    if not message.startswith("calibrated"):
        raise UsageError(f"the camera cannot be calibrated: {message}")
    return node


def frame_errors(node: VisionNode, camera: CameraParams, seed: int, number: int) -> tuple[NDArray[np.float64], int]:
    """Detect three parts and a robot at random positions on the table.

    Returns the errors of x, y and radius of the discs found, (K, 3) in metres, and the number of false discs.
    """
    task = layout_task("3H")
    robot, parts = draw_starts(task, WorkspaceConfig(start_gap=0.0), generator(seed, "vision frame", number))
    discs = [
        DrawnDisc(x, y, spec.radius, camera.part_colour)
        for (x, y), spec in zip(parts.tolist(), task.parts, strict=True)
    ]
    discs.append(DrawnDisc(float(robot[0]), float(robot[1]), task.robot_radius, camera.robot_colour, 1.0))
    detections, _ = _shown(node, render(discs, camera, seed, number), camera, number)
    truth = np.array([(disc.x_m, disc.y_m, disc.radius_m) for disc in discs])
    found = np.array([(disc.x, disc.y, disc.radius) for disc in detections.discs]).reshape(-1, 3)
    apart = np.abs(found[:, None] - truth).max(axis=2)
    matched = [(int(np.argmin(row)), i) for i, row in enumerate(apart) if row.min() <= _SAME_M]
    known = dict(matched)
    errors = np.array([found[i] - truth[k] for k, i in known.items()]).reshape(-1, 3)
    return errors, len(found) - len(known)


def _shown(node: VisionNode, frame: NDArray[np.uint8], camera: CameraParams, number: int) -> tuple[Detections, str]:
    """Return the node's detections in a frame, and its log message or an empty string."""
    image = CompressedImage(timestamp=timestamp(0), frame_id=CAMERA_FRAME, data=encode(frame, camera), format="jpeg")
    received = Received("camera/image", "simulator", "", number, number, image)
    messages = [output.message for output in node.step(Step(number, number, number, (received,))).outputs]
    detections = next(message for message in messages if isinstance(message, Detections))
    return detections, next((message.message for message in messages if isinstance(message, Log)), "")


def _look(part: _Frames) -> Sample:
    camera = CAMERAS[part.camera]
    node = calibrated_node(camera, part.seed)
    seen = [frame_errors(node, camera, part.seed, part.trial * FRAMES + number + 1) for number in range(FRAMES)]
    errors = np.concatenate([found for found, _ in seen])
    centre = float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))
    return Sample(
        {"view": f"frames: {part.camera}"},
        {
            "discs": 4.0 * FRAMES,
            "missed_discs_percent": 100.0 * (1.0 - len(errors) / (4 * FRAMES)),
            "invented_discs": float(sum(invented for _, invented in seen)),
            "centre_error_mm": 1000.0 * centre,
            "radius_error_mm": 1000.0 * float(np.sqrt((errors[:, 2] ** 2).mean())),
            "centre_error_px": centre * camera.focal_px / camera.height_m / SUBSAMPLING,
        },
    )


def _look_at_scenes(part: _Scenes) -> Sample:
    scenes = [draw_scene(part.kind, part.seed, part.trial * SCENES + number) for number in range(SCENES)]
    scores = [score(scene, detect_discs(scene.image, DetectionParams())) for scene in scenes]
    found = np.concatenate([score_of_scene.found for score_of_scene in scores])
    centre = np.concatenate([score_of_scene.centre_error_px for score_of_scene in scores])[found]
    radius = np.concatenate([score_of_scene.radius_error_px for score_of_scene in scores])[found]
    return Sample(
        {"view": f"drawn: {part.kind}"},
        {
            "discs": float(len(found)),
            "missed_discs_percent": 100.0 * float(1.0 - found.mean()),
            "invented_discs": float(sum(score_of_scene.false_discs for score_of_scene in scores)),
            "centre_error_px": float(np.sqrt((centre**2).mean())),
            "radius_error_px": float(np.sqrt((radius**2).mean())),
        },
    )


def photograph(path: str) -> NDArray[np.uint8]:
    """Return an image file as grey levels (H, W); raises UsageError if it is not an image."""
    image = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise UsageError(f"{path}: no image")
    return np.asarray(image, dtype=np.uint8)


def _figures(settings: VisionSettings, seed: int, rows: list[Row], folder: Path) -> list[Path]:
    from dynpf_systems.parts.studies.vision_figures import draw  # noqa: PLC0415 - needs matplotlib

    return draw(settings.photographs, seed, rows, folder)


STUDY = Study(
    about="PARTS with a camera: the task with three parts from camera frames only; accuracy of the detection of discs",
    trials=10,
    settings=VisionSettings,
    tasks=_parts,
    run_task=_run_part,
    rows=_rows,
    columns=(
        ("view", "", "view"),
        ("parts", "", "parts"),
        ("goals", "", "goals"),
        ("noise", "", "noise"),
        ("n", "", "n"),
        ("trials", "", "trials"),
        ("completed %", ".0f", "completed_25mm_percent"),
        ("collided %", ".0f", "collided_percent"),
        ("npl", ".3f", "npl_mean"),
        ("final cm: mean / max", ".2f", "final_error_mean_cm_mean final_error_max_cm_mean"),
        ("rpee cm", ".2f", "rpee_cm_mean"),
        ("ppee cm", ".2f", "ppee_cm_mean"),
        ("discs a trial", ".0f", "discs_mean"),
        ("missed %", ".2f", "missed_discs_percent_mean"),
        ("false", ".2f", "invented_discs_mean"),
        ("centre mm", ".2f", "centre_error_mm_mean"),
        ("radius mm", ".2f", "radius_error_mm_mean"),
        ("centre px", ".3f", "centre_error_px_mean"),
        ("radius px", ".3f", "radius_error_px_mean"),
    ),
    figures=_figures,
)
