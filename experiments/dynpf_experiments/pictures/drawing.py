"""What can be drawn of a run, in the plane of its map and over time; systems bring drawings too (``PICTURES``).

Positions are in metres of the map as it is drawn, or, where a drawing has another ``Unit``, in that unit.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple

from dynpf.maps.occupancy import OccupancyGrid
from dynpf.types import FloatArray

if TYPE_CHECKING:
    from dynpf_experiments.pictures.source import RunSource

__all__ = ["Circle", "Drawing", "Layer", "Line", "Metre", "Pictures", "Plot", "Shape", "Track", "Unit"]

Role = Literal["truth", "estimate", "odometry", "body"]
Part = Literal["wall", "landmark", "goal", "obstacle", "drawn"]
Form = Literal["line", "loop", "pairs", "disc", "area", "text"]


class Unit(NamedTuple):
    """The unit of positions, and how many make up a metre of what nodes publish for viewers."""

    name: str
    per_metre: float


Metre = Unit("m", 1.0)


class Track(NamedTuple):
    """Poses of something that moves: at ``seconds`` (T,) it was at ``poses`` (3, T), until the next.

    ``role`` says what it is: the true robot, an estimate, odometry alone, or a body beside the robot. ``covariances``
    (3, 3, T) are those of an estimate; ``radius`` is that of a disc, 0 if it has no size. The heading is NaN where it
    is not known. Tracks of one ``robot``, its namespace, belong together.
    """

    name: str
    role: Role
    robot: str
    seconds: FloatArray
    poses: FloatArray
    covariances: FloatArray | None = None
    radius: float = 0.0


class Shape(NamedTuple):
    """A shape from above: a ``line`` or ``loop`` through points (2, M), lines between ``pairs`` of them, a ``disc``
    around each, a filled ``area``, or a ``text``.

    ``colour`` is ``#rrggbb``, or "" for that of its part of the world.
    """

    form: Form
    points: FloatArray
    part: Part
    radius: float = 0.0
    text: str = ""
    colour: str = ""


class Layer(NamedTuple):
    """Shapes that change: those of a moment (T,) are shown until the next."""

    seconds: FloatArray
    shapes: Sequence[Sequence[Shape]]


class Line(NamedTuple):
    """A line of a plot: values (T,) at seconds (T,); NaN where there is none.

    A ``band`` is drawn from its negative, or from 0 where nothing is negative, to the value; a ``bound`` is dashed.
    ``hidden`` lines are shown on demand.
    """

    label: str
    seconds: FloatArray
    values: FloatArray
    kind: Literal["line", "band", "bound"] = "line"
    hidden: bool = False


class Plot(NamedTuple):
    """Lines over time in one unit; ``about`` says in a sentence how to read them."""

    key: str
    title: str
    unit: str
    lines: Sequence[Line]
    about: str = ""
    signed: bool = False


class Circle(NamedTuple):
    """A circle in an image, px."""

    u: float
    v: float
    radius: float


class Drawing(NamedTuple):
    """What is drawn of a run.

    ``circles`` returns what to draw over the frame of a camera's topic, by the frame's stamp in ns. ``replaced`` are
    the ids of scene entities that need not be drawn, as tracks or shapes show the same. ``cells`` are maps that are
    drawn as shapes, and that viewers get as cells.
    """

    unit: Unit = Metre
    grids: Sequence[OccupancyGrid] = ()
    cells: Sequence[OccupancyGrid] = ()
    shapes: Sequence[Shape] = ()
    layers: Sequence[Layer] = ()
    tracks: Sequence[Track] = ()
    plots: Sequence[Plot] = ()
    circles: Mapping[str, Callable[[int], Sequence[Circle]]] = {}
    replaced: frozenset[str] = frozenset()
    radii: Mapping[str, float] = {}  # of robots, by namespace


class Pictures(NamedTuple):
    """The pictures of a system: ``draw`` returns what is drawn of a run, None where it is none of the system's."""

    draw: "Callable[[RunSource], Drawing | None]"


def merged(drawings: Sequence[Drawing]) -> Drawing:
    """Return all drawings as one, in the unit of the first."""
    return Drawing(
        unit=drawings[0].unit if drawings else Metre,
        grids=[grid for drawing in drawings for grid in drawing.grids],
        cells=[grid for drawing in drawings for grid in drawing.cells],
        shapes=[shape for drawing in drawings for shape in drawing.shapes],
        layers=[layer for drawing in drawings for layer in drawing.layers],
        tracks=[track for drawing in drawings for track in drawing.tracks],
        plots=[plot for drawing in drawings for plot in drawing.plots],
        circles={topic: found for drawing in drawings for topic, found in drawing.circles.items()},
        replaced=frozenset[str]().union(*(drawing.replaced for drawing in drawings)),
        radii={robot: radius for drawing in drawings for robot, radius in drawing.radii.items()},
    )
