"""The maps of ROS: a YAML file and an image, read as map_server and nav2_map_server do."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from dynpf.maps.image import Shades, decode_image
from dynpf.maps.occupancy import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.maps.yaml_text import mapping, number, short
from dynpf.types import FloatArray

__all__ = ["decode"]

MODES = ("trinary", "scale", "raw")
LONGEST = 2**16  # characters of a file, which takes a tenth of a second to read


def decode(yaml_text: str, images: Callable[[str], bytes], name: str) -> OccupancyGrid:
    """Return the map that a map_server YAML file describes.

    ``images`` returns the bytes of an image named as the file names it, commonly relative to the file, but with slashes
    for backslashes, and raises OSError or KeyError where there is none. ``name`` is what errors call the file.

    Keys: image, resolution (metres a pixel), origin ([x, y, yaw] of the lower left corner), negate (white is
    occupied), occupied_thresh, free_thresh and mode; any others are ignored. A pixel darker than occupied_thresh is
    occupied, one lighter than free_thresh free, one between unknown, darkness running from 0 (white) to 1. Modes:
    - trinary (the default): colour channels are averaged, and alpha with them;
    - scale: alpha does not count, but a pixel that is not opaque is unknown. The probabilities that ROS gives to the
      pixels between the thresholds are not kept: they are unknown;
    - raw: the pixel's byte is itself the occupancy in percent, negate or not; one above 100 is unknown. The thresholds
      divide it as they divide darkness.

    Raises ValueError, in one line that names the file, the key, its value and what was expected.
    """
    keys = _Keys(name, mapping(yaml_text, name, longest=LONGEST, kind="map_server file", such_as="image"))
    resolution = keys.number("resolution")
    if not resolution > 0.0:
        raise keys.wrong("resolution", "metres a pixel, above 0")
    origin = keys.origin()
    negate = keys.negate()
    free_below, occupied_above = keys.thresholds()
    mode = keys.mode()
    shades = keys.shades(images)
    occupancy = _occupancy(shades, mode, negate)
    cells = np.full(occupancy.shape, UNKNOWN, dtype=np.uint8)
    cells[occupancy < free_below] = FREE
    cells[occupancy > occupied_above] = OCCUPIED
    return OccupancyGrid(cells[::-1], resolution, origin)


def _occupancy(shades: Shades, mode: str, negate: bool) -> FloatArray:
    """Return how occupied each pixel is, 0 to 1; NaN where that is unknown."""
    if mode == "raw":
        percent = np.rint(255.0 * shades.colour)
        return np.where(percent <= 100.0, percent / 100.0, math.nan)
    shade = shades.colour
    if mode == "trinary" and shades.alpha is not None:
        shade = (3.0 * shade + shades.alpha) / 4.0
    occupancy = shade if negate else 1.0 - shade
    if mode == "scale" and shades.alpha is not None:
        occupancy = np.where(shades.alpha < 1.0, math.nan, occupancy)
    return occupancy


class _Keys:
    """The keys of one file, each checked when it is taken."""

    def __init__(self, name: str, values: dict[Any, Any]) -> None:
        self._name = name
        self._values = values

    def wrong(self, key: str, expected: str) -> ValueError:
        return ValueError(f"{self._name}: {key} = {short(self._values[key])}; expected {expected}")

    def number(self, key: str) -> float:
        found = number(self._take(key))
        if found is None:
            raise self.wrong(key, "a finite number")
        return found

    def origin(self) -> tuple[float, float, float]:
        expected = "[x, y, yaw], three finite numbers in metres and radians"
        value = self._take("origin")
        if not isinstance(value, list) or len(value) != 3:
            raise self.wrong("origin", expected)
        x, y, yaw = (number(part) for part in value)
        if x is None or y is None or yaw is None:
            raise self.wrong("origin", expected)
        return x, y, yaw

    def negate(self) -> bool:
        value = self._take("negate")
        if value not in (0, 1):  # true and false are equal to these
            raise self.wrong("negate", "0 or 1")
        return bool(value)

    def thresholds(self) -> tuple[float, float]:
        free, occupied = self.number("free_thresh"), self.number("occupied_thresh")
        for key, value in (("free_thresh", free), ("occupied_thresh", occupied)):
            if not 0.0 <= value <= 1.0:
                raise self.wrong(key, "a share between 0 and 1")
        if free > occupied:
            raise self.wrong("free_thresh", f"no more than occupied_thresh, which is {occupied}")
        return free, occupied

    def mode(self) -> str:
        value = str(self._values.get("mode", "trinary")).lower()
        if value not in MODES:
            raise self.wrong("mode", f"one of {', '.join(MODES)}")
        return value

    def shades(self, images: Callable[[str], bytes]) -> Shades:
        path = self._take("image")
        if not isinstance(path, str) or not path:
            raise self.wrong("image", "the path of an image")
        try:
            return decode_image(images(path.replace("\\", "/")))  # of a map that was saved under Windows
        except (OSError, KeyError) as error:
            reason = getattr(error, "strerror", None) or "not found"
            raise ValueError(f"{self._name}: image = {path!r} cannot be read: {reason.lower()}") from None
        except ValueError as error:
            raise ValueError(f"{self._name}: image = {path!r} is {error}") from None

    def _take(self, key: str) -> Any:
        if key not in self._values:
            raise ValueError(f"{self._name}: {key} is missing; a map_server file must state it")
        return self._values[key]
