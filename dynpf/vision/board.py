"""A calibration board: a grid of dots, of which three larger ones tell where its origin and its axes are."""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynpf.portable import norm
from dynpf.types import Positive
from dynpf.vision.calibration import CalibrationError
from dynpf.vision.discs import Disc

__all__ = ["Board", "find_board"]

Half = Annotated[int, msgspec.Meta(ge=2, le=10)]
Place = tuple[int, int]

_MARKED: tuple[Place, ...] = ((0, 0), (1, 0), (0, 2))
_NEAR = 0.3  # of a step: how far from where it is expected a dot is looked for


class Board(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind", tag="board"):
    """Dots at whole multiples of a spacing about the workspace's origin, metres; larger are (0, 0), (1, 0), (0, 2)."""

    half_columns: Half = 3  # dots to either side of the middle: 7 in a row
    half_rows: Half = 3
    spacing_m: Positive = 0.3
    dot_radius_m: Positive = 0.04
    marker_radius_m: Positive = 0.07

    def dots(self) -> list[tuple[float, float, float]]:
        """Return x, y, radius of each dot."""
        return [
            (
                self.spacing_m * i,
                self.spacing_m * j,
                self.marker_radius_m if (i, j) in _MARKED else self.dot_radius_m,
            )
            for j in range(-self.half_rows, self.half_rows + 1)
            for i in range(-self.half_columns, self.half_columns + 1)
        ]


def find_board(discs: Sequence[Disc], board: Board) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the dots' centres in the image, pixels (K, 2), and on the board, metres (K, 2).

    Starts from the three largest discs and goes from dot to dot, so a lens that bends the grid does no harm. Raises
    CalibrationError when fewer than half of the dots are found.
    """
    count = len(board.dots())
    if len(discs) < count / 2:
        raise CalibrationError(f"{len(discs)} discs in view, too few for a board of {count} dots")
    centres = np.array([(disc.x_px, disc.y_px) for disc in discs])
    largest = np.argsort([-disc.radius_px for disc in discs], kind="stable")[:3]
    origin, right, up = _in_order(centres[largest])
    steps = {(1, 0): right - origin, (0, 1): (up - origin) / 2}
    steps |= {(-i, -j): -step for (i, j), step in steps.items()}
    found: dict[Place, NDArray[np.float64]] = {(0, 0): origin}
    ahead: list[tuple[Place, dict[Place, NDArray[np.float64]]]] = [((0, 0), steps)]
    while ahead:
        place, known = ahead.pop(0)
        for (i, j), step in known.items():
            beside = (place[0] + i, place[1] + j)
            if beside in found or abs(beside[0]) > board.half_columns or abs(beside[1]) > board.half_rows:
                continue
            distance = norm(centres - found[place] - step, axis=1)
            nearest = int(np.argmin(distance))
            if distance[nearest] <= _NEAR * norm(step):
                found[beside] = centres[nearest]
                taken = centres[nearest] - found[place]
                ahead.append((beside, {**known, (i, j): taken, (-i, -j): -taken}))
    if len(found) < count / 2:
        raise CalibrationError(f"found {len(found)} of the board's {count} dots, need half of them")
    return np.array(list(found.values())), board.spacing_m * np.array(list(found), dtype=np.float64)


def _in_order(markers: NDArray[np.float64]) -> NDArray[np.float64]:
    """The markers (3, 2) as (0, 0), (1, 0), (0, 2): the sides between them are 1, 2 and sqrt(5) steps long."""
    opposite = norm(np.roll(markers, -1, axis=0) - np.roll(markers, -2, axis=0), axis=1)
    up, right, origin = np.argsort(
        opposite, kind="stable"
    )  # opposite the shortest side, the middle one and the longest
    return np.asarray(markers[[origin, right, up]])
