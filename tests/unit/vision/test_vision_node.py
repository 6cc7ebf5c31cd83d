"""The vision node: frames in, discs in metres out, and what it does with frames it cannot use."""

import cv2
import msgspec
import numpy as np
import pytest
from dynpf_protocol.messages import CompressedImage, Log, Message, timestamp
from dynpf_runtime.node import Received, Step, decode_state, encode_state
from dynpf_systems.parts.camera import DrawnDisc, board_discs, encode, render
from dynpf_systems.parts.camera_model import CameraParams, calibration_pairs
from dynpf_systems.parts.messages import Detections
from dynpf_systems.parts.vision import VisionNode
from dynpf_systems.parts.vision_config import VisionConfig

from dynpf.vision import Board

CAMERA = CameraParams()
SCENE = [
    DrawnDisc(0.2, 0.1, 0.10, CAMERA.robot_colour, 0.3),
    DrawnDisc(0.2 + 0.17 * np.cos(0.3), 0.1 + 0.17 * np.sin(0.3), 0.06, CAMERA.part_colour),
    DrawnDisc(-0.85, 0.88, 0.11, CAMERA.part_colour),
    DrawnDisc(0.7, -0.6, 0.08, CAMERA.part_colour),
]
JPEG = encode(render(SCENE, CAMERA, seed=4, tick=0), CAMERA)
POINTS = tuple((u, v, x, y) for u, v, x, y in calibration_pairs(CAMERA))


def node_of(config: VisionConfig | None = None, seed: int = 1) -> VisionNode:
    return VisionNode(config=config or VisionConfig(calibration=POINTS), seed=seed)


def step_with(*frames: bytes, tick: int = 3) -> Step:
    images = [CompressedImage(timestamp=timestamp(0), frame_id="camera", data=data, format="jpeg") for data in frames]
    inputs = tuple(Received("camera/image", "simulator", "b", i, i * 1000, image) for i, image in enumerate(images))
    return Step(number=tick, tick=tick, stamp_ns=150_000_000, inputs=inputs)


def seen(node: VisionNode, step: Step) -> tuple[Detections, tuple[Message, ...]]:
    first, *others = (output.message for output in node.step(step).outputs)
    assert isinstance(first, Detections)
    return first, tuple(others)


def test_sees_every_disc_in_its_place() -> None:
    detections, others = seen(node_of(), step_with(JPEG))
    found = sorted((disc.radius, disc.x, disc.y) for disc in detections.discs)
    truth = sorted((disc.radius_m, disc.x_m, disc.y_m) for disc in SCENE)
    assert np.array(found) == pytest.approx(np.array(truth), abs=6e-4)
    robot = min(detections.discs, key=lambda disc: disc.grey)
    assert robot.radius == pytest.approx(0.10, abs=6e-4)
    assert robot.grey < 1.5 * max(disc.grey for disc in detections.discs)
    assert all(0 < disc.residual < 1e-3 for disc in detections.discs)
    assert others == ()


def test_calibrates_itself_from_the_board_and_goes_on_when_thawed() -> None:
    camera = CameraParams(radial_distortion=-0.15, rotation_rad=1.6, board=Board())
    board = encode(render(board_discs(Board(), camera), camera, seed=4, tick=0), camera)
    scene = encode(render(SCENE, camera, seed=4, tick=1), camera)
    node = node_of(VisionConfig(calibration=Board()))
    assert "too few for a board" in str(seen(node, step_with(scene))[1])
    detections, (said,) = seen(node, step_with(board))
    assert detections.discs == ()
    assert "calibrated" in str(said)
    other = node_of(VisionConfig(calibration=Board()))
    other.thaw(decode_state(encode_state(node.freeze())))
    found, quiet = seen(other, step_with(scene))
    assert quiet == ()
    truth = sorted((disc.radius_m, disc.x_m, disc.y_m) for disc in SCENE)
    assert sorted((disc.radius, disc.x, disc.y) for disc in found.discs) == [
        pytest.approx(one, abs=6e-4) for one in truth
    ]
    straight, _ = seen(node_of(), step_with(scene))  # calibrated for another camera
    assert min(np.hypot(disc.x - SCENE[2].x_m, disc.y - SCENE[2].y_m) for disc in straight.discs) > 0.1


def test_a_png_frame_is_as_good() -> None:
    png = cv2.imencode(".png", render(SCENE, CAMERA, seed=4, tick=0))[1].tobytes()
    detections, _ = seen(node_of(), step_with(png))
    assert len(detections.discs) == len(SCENE)


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"", "no image"),
        (b"\x00" * 500, "no image"),
        (JPEG[: len(JPEG) // 2], "cut off"),
        (JPEG[:3] + b"\xff\xd9", "no image"),
        (encode(render([], CameraParams(width_px=640, height_px=512), 1, 1), CAMERA), "640 x 512"),
    ],
)
def test_a_broken_frame_is_reported_and_the_next_is_seen(data: bytes, complaint: str) -> None:
    node = node_of()
    detections, (warning,) = seen(node, step_with(data))
    assert detections.discs == ()
    assert isinstance(warning, Log)
    assert complaint in warning.message
    assert "tick 3" in warning.message
    assert len(seen(node, step_with(JPEG))[0].discs) == len(SCENE)


def test_the_newest_frame_counts_and_none_gives_nothing() -> None:
    node = node_of()
    empty = encode(render([], CAMERA, seed=4, tick=0), CAMERA)
    assert seen(node, step_with(JPEG, empty))[0].discs == ()
    assert len(seen(node, step_with(empty, JPEG))[0].discs) == len(SCENE)
    assert node.step(step_with()).outputs == ()


def test_noise_has_its_spread_and_hangs_on_seed_and_tick() -> None:
    sharp, _ = seen(node_of(), step_with(JPEG))
    config = VisionConfig(calibration=POINTS, position_noise_m=0.01)

    nodes = {seed: node_of(config, seed) for seed in (1, 2)}

    def noise(seed: int, tick: int) -> np.ndarray:
        detections, _ = seen(nodes[seed], step_with(JPEG, tick=tick))
        pairs = zip(detections.discs, sharp.discs, strict=True)
        return np.array([(disc.x - true.x, disc.y - true.y) for disc, true in pairs])

    assert np.array_equal(noise(1, 3), noise(1, 3))
    assert not np.array_equal(noise(1, 3), noise(1, 4))
    assert not np.array_equal(noise(1, 3), noise(2, 3))
    many = np.concatenate([noise(1, tick) for tick in range(40)])
    assert many.std() == pytest.approx(0.01, rel=0.12)
    assert np.abs(many.mean(axis=0)).max() < 0.003


@pytest.mark.parametrize(
    ("section", "complaint"),
    [
        ({"position_noise_m": -0.1}, "position_noise_m"),
        ({"calibration": [[0, 0, 0, 0]] * 6}, "one line"),
        ({"calibration": [[0, 0, 0, 0]] * 5}, "calibration"),
        ({"width_px": 1281}, "width_px"),
        ({"detection": {"rays": 3}}, "rays"),
    ],
)
def test_configuration_is_checked_where_it_is_read(section: dict[str, object], complaint: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=complaint):
        msgspec.convert(section, VisionConfig)
