"""The logs in the folder of data that studies know by name (``logs.toml``)."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Literal

import msgspec

__all__ = ["LandmarkSource", "LaserSource", "PlacedMap", "Sources", "sources"]


class PlacedMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An image with its resolution and origin, as in the YAML file of map_server."""

    image: str
    resolution: float  # m
    origin: tuple[float, float, float]  # m, m, rad: of the lower left corner
    occupied_thresh: float
    free_thresh: float

    def yaml(self) -> str:
        """Return the YAML file."""
        return (
            f"image: {Path(self.image).name}\nresolution: {self.resolution}\norigin: {list(self.origin)}\n"
            f"negate: 0\noccupied_thresh: {self.occupied_thresh}\nfree_thresh: {self.free_thresh}\n"
        )


class LaserSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A log with laser scans: a file with its settings, or half of another log; see ``logs.toml``."""

    format: Literal["carmen", "rosbag"] = "carmen"
    file: str = ""
    split_of: str = ""
    map: str = ""
    map_from_poses_m: float = 0.05
    placed_map: PlacedMap | None = None
    truth_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad
    truth_shift_s: float = 0.0


class LandmarkSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A folder of a UTIAS MRCLAM data set."""

    folder: str


class Sources(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The logs by name."""

    laser: dict[str, LaserSource]
    landmark: dict[str, LandmarkSource]


@cache
def sources() -> Sources:
    """Return the logs that studies know by name."""
    return msgspec.convert(tomllib.loads((Path(__file__).parent / "logs.toml").read_text(encoding="utf-8")), Sources)
