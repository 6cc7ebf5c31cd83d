"""The vision node: camera frames in, discs in workspace coordinates out."""

import math
from collections.abc import Sequence
from typing import cast

import cv2
import msgspec
import numpy as np
from dynpf_protocol.messages import CompressedImage, Log, LogLevel, timestamp
from dynpf_runtime.node import Output, Result, State, Step
from dynpf_services.scenario.context import Context
from msgspec import UNSET, UnsetType
from numpy.typing import NDArray

from dynpf.image_size import is_whole, size_of
from dynpf.rng import generator
from dynpf.vision import Board, Calibration, CalibrationError, Disc, detect_discs
from dynpf_systems.parts.messages import Detection, Detections
from dynpf_systems.parts.vision_config import VisionConfig

__all__ = ["BrokenFrameError", "VisionNode", "build"]

SUBSAMPLING = 4  # 1280 x 1024 -> 320 x 256
MAX_DISCS = 256  # capacity of a Detections message

_INNER = 0.8  # of a disc's radius, within which its colour is looked at
_JPEG_END = b"\xff\xd9"


class BrokenFrameError(ValueError):
    """A frame cannot be decoded, or does not agree with the configuration."""


class VisionNode:
    """Detects discs in the newest frame of each step; its only state is the calibration.

    With a board in its configuration it calibrates itself from the first frame that shows the board, and reports it on
    ``log``. An unusable frame gives an empty list of discs and a warning; a step without a frame gives nothing.
    """

    def __init__(self, *, config: VisionConfig, seed: int, name: str = "vision", colours: bool = False) -> None:
        """Report the ``colours`` of the discs, too."""
        self.name = name
        self._colours = colours
        self._config = config
        self._seed = seed
        self._calibration = None if isinstance(config.calibration, Board) else config.calibrated()

    def step(self, step: Step) -> Result:
        """Return the discs in the newest frame; calibrate first where the configuration has a board."""
        frames = [item for item in step.inputs if isinstance(item.message, CompressedImage)]
        if not frames:
            return Result()
        newest = max(frames, key=lambda item: item.stamp_ns).message
        logs: tuple[Output, ...] = ()
        detections: tuple[Detection, ...] = ()
        try:
            discs = detect_discs(self._decode(cast(CompressedImage, newest).data), self._config.detection)
            if self._calibration is None:
                self._calibration = self._config.calibrated(discs, SUBSAMPLING)
                logs = (self._log(LogLevel.INFO, f"calibrated: {self._calibration.rms_px:.3f} px rms", step),)
            else:
                data = cast(CompressedImage, newest).data if self._colours else b""
                colours = _colours(data, discs) if data else [UNSET] * len(discs)
                detections = self._detections(discs, colours, self._calibration, step.number)
        except (BrokenFrameError, CalibrationError) as error:
            logs = (self._log(LogLevel.WARNING, f"camera/image of tick {step.tick}: {error}", step),)
        return Result((Output("vision/detections", Detections(discs=detections)), *logs))

    def freeze(self) -> State:
        """Return the calibration, if it is not given by the scenario."""
        # A calibration given by the scenario is no state.
        if not isinstance(self._config.calibration, Board):
            return {}
        return {"calibration": msgspec.to_builtins(self._calibration)}

    def thaw(self, state: State) -> None:
        """Continue from what freeze returned."""
        if "calibration" in state:
            self._calibration = msgspec.convert(state["calibration"], Calibration | None)

    def _log(self, level: LogLevel, message: str, step: Step) -> Output:
        return Output("log", Log(timestamp=timestamp(step.stamp_ns), level=level, message=message, name=self.name))

    def _detections(
        self,
        discs: Sequence[Disc],
        colours: Sequence[tuple[float, float, float] | UnsetType],
        calibration: Calibration,
        number: int,
    ) -> tuple[Detection, ...]:
        if len(discs) > MAX_DISCS:
            raise BrokenFrameError(f"{len(discs)} discs found, at most {MAX_DISCS} fit a message")
        located = calibration.discs_to_workspace(discs, SUBSAMPLING)
        noise = self._noise(len(discs), number)
        return tuple(
            Detection(
                x=located_disc.x + dx,
                y=located_disc.y + dy,
                radius=located_disc.radius,
                grey=disc.grey,
                residual=disc.residual_px * located_disc.radius / disc.radius_px,
                colour=colour,
            )
            for disc, colour, located_disc, (dx, dy) in zip(discs, colours, located, noise.tolist(), strict=True)
        )

    def _decode(self, data: bytes) -> NDArray[np.uint8]:
        """Decode to grey at a quarter of the frame's size, in a single pass of the decoder."""
        if data.startswith(b"\xff\xd8") and not data.endswith(_JPEG_END):
            raise BrokenFrameError(f"JPEG of {len(data)} bytes is cut off")
        size, expected = size_of(data), (self._config.width_px, self._config.height_px)
        if size is not None and size != expected:
            raise BrokenFrameError(f"frame of {size[0]} x {size[1]} pixels; expected {expected[0]} x {expected[1]}")
        try:
            encoded = np.frombuffer(data, np.uint8)
            readable = size is not None and is_whole(data)
            image = cv2.imdecode(encoded, cv2.IMREAD_REDUCED_GRAYSCALE_4) if readable else None
        except cv2.error as error:
            raise BrokenFrameError(f"{len(data)} bytes that are no image ({error.err})") from error
        if image is None or image.shape != tuple(side // SUBSAMPLING for side in reversed(expected)):
            raise BrokenFrameError(f"{len(data)} bytes that are no image; expected a PNG or JPEG")
        return np.asarray(image, dtype=np.uint8)

    def _noise(self, count: int, number: int) -> NDArray[np.float64]:
        draws = generator(self._seed, self.name, number, "position noise").standard_normal((count, 2))
        return (self._config.position_noise_m or 0.0) * draws


def _colours(data: bytes, discs: Sequence[Disc]) -> list[tuple[float, float, float] | UnsetType]:
    """Return the median blue, green and red within each disc of a frame that has been decoded before, where in view."""
    whole = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    image = whole.reshape(*whole.shape[:2], -1)[SUBSAMPLING // 2 :: SUBSAMPLING, SUBSAMPLING // 2 :: SUBSAMPLING, :3]
    if image.shape[2] < 3:  # a grey frame
        image = np.repeat(image[:, :, :1], 3, axis=2)
    rows, columns = np.arange(image.shape[0])[:, None], np.arange(image.shape[1])
    found: list[tuple[float, float, float] | UnsetType] = []
    for disc in discs:
        reach = _INNER * disc.radius_px
        inside = np.square(columns - disc.x_px) + np.square(rows - disc.y_px) <= reach * reach
        if inside.any():
            blue, green, red = np.median(image[inside], axis=0).tolist()
            found.append((blue, green, red))
        else:
            found.append(UNSET)
    return found


def build(config: VisionConfig, context: Context) -> VisionNode:
    """Return the vision of a run, with the noise of its task unless the configuration overrides it."""
    task = context.fact("task")
    if config.position_noise_m is None and task is not None:
        config = msgspec.structs.replace(config, position_noise_m=math.sqrt(task.variances.measurement))
    colours = task is not None and any(colour is not None for colour in task.colours)
    return VisionNode(config=config, seed=context.seed, name=context.name, colours=colours)
