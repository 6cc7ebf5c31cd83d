"""Scenes that nodes draw for viewers, seen from above; so a node of the user's is on the page as it is in Foxglove."""

from collections.abc import Iterator, Sequence

import numpy as np
from dynpf_protocol.messages import (
    Color,
    CylinderPrimitive,
    LinePrimitive,
    Point3,
    Pose,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    heading,
)
from dynpf_protocol.printable import printable

from dynpf.portable import sincos
from dynpf.types import FloatArray
from dynpf_experiments.pictures.drawing import Form, Layer, Shape
from dynpf_experiments.pictures.source import RunSource

__all__ = ["scenes_of"]

MOST_SHAPES = 300  # of an entity
MOST_POINTS = 20_000  # of all that is drawn

_FORMS: tuple[Form, ...] = ("line", "loop", "pairs")  # of Foxglove's types of lines


def scenes_of(source: RunSource, replaced: frozenset[str], per_metre: float) -> tuple[list[Shape], list[Layer]]:
    """Return the shapes that stay and the layers that change, of all entities but those ``replaced``.

    An entity that two topics draw is taken of the first.
    """
    shapes: list[Shape] = []
    layers: list[Layer] = []
    left, known = MOST_POINTS, set(replaced)
    for topic in source.carrying(SceneUpdate):
        entities = _entities(source, topic, known)
        known |= {name for name, _ in entities}
        for _, moments in entities:
            drawn = [(at, [*_shapes(entity, per_metre)] if entity else []) for at, entity in moments]
            changes = [
                drawn[index] for index in range(len(drawn)) if index == 0 or not _same(drawn[index], drawn[index - 1])
            ]
            while changes and sum(_size(each) for _, each in changes) > left:
                changes.pop()
            left -= sum(_size(each) for _, each in changes)
            if len(changes) == 1:
                shapes += changes[0][1]
            elif changes:
                layers.append(Layer(np.array([at for at, _ in changes]), [s for _, s in changes]))
    return shapes, layers


def _entities(
    source: RunSource, topic: str, known: set[str]
) -> list[tuple[str, list[tuple[float, SceneEntity | None]]]]:
    """Return the entities of a topic by id, each with the times at which it is drawn, or deleted (None)."""
    found: dict[str, list[tuple[float, SceneEntity | None]]] = {}
    for at, message in source.messages(topic, source.budget.scenes):
        if not isinstance(message, SceneUpdate):
            continue
        for deletion in message.deletions:
            gone = [*found] if deletion.type == 1 else [deletion.id]
            for name in gone:
                if name in found:
                    found[name].append((at, None))
        for entity in message.entities:
            if entity.id not in known and (entity.id in found or len(found) < MOST_SHAPES):
                found.setdefault(entity.id, []).append((at, entity))
    return list(found.items())


def _shapes(entity: SceneEntity, scale: float) -> Iterator[Shape]:
    discs: list[CylinderPrimitive | SpherePrimitive] = [*entity.cylinders, *entity.spheres]
    for disc in discs[:MOST_SHAPES]:
        yield _shape("disc", _placed(disc.pose, [(0.0, 0.0)], scale), disc.color, 0.5 * scale * abs(disc.size.x))
    for cube in entity.cubes[:MOST_SHAPES]:
        x, y = 0.5 * cube.size.x, 0.5 * cube.size.y
        yield _shape("area", _placed(cube.pose, [(-x, -y), (x, -y), (x, y), (-x, y)], scale), cube.color)
    for arrow in entity.arrows[:MOST_SHAPES]:
        length = arrow.shaft_length + arrow.head_length
        side = 0.5 * arrow.head_diameter
        tip = [(0.0, 0.0), (length, 0.0), (arrow.shaft_length, side), (arrow.shaft_length, -side), (length, 0.0)]
        yield _shape("line", _placed(arrow.pose, tip, scale), arrow.color)
    for line in entity.lines[:MOST_SHAPES]:
        yield _shape(_FORMS[line.type], _placed(line.pose, _points(line), scale), line.color)
    for mesh in entity.triangles[:MOST_SHAPES]:
        corners = [(point.x, point.y) for point in mesh.points[:MOST_POINTS]]
        for begin in range(0, len(corners) - 2, 3):
            yield _shape("area", _placed(mesh.pose, corners[begin : begin + 3], scale), mesh.color)
    for text in entity.texts[:MOST_SHAPES]:
        shape = _shape("text", _placed(text.pose, [(0.0, 0.0)], scale), text.color)
        yield shape._replace(text=printable(text.text, 80))


def _points(line: LinePrimitive) -> list[tuple[float, float]]:
    points: Sequence[Point3] = line.points
    if line.indices:
        points = [points[index] for index in line.indices[:MOST_POINTS] if index < len(points)]
    return [(point.x, point.y) for point in points[:MOST_POINTS]]


def _placed(pose: Pose, points: Sequence[tuple[float, float]], scale: float) -> FloatArray:
    """Return points (2, M) of a pose's frame in the map, in the drawing's unit."""
    x, y = np.array(points, dtype=np.float64).reshape(-1, 2).T
    sine, cosine = (float(value) for value in sincos(heading(pose.orientation)))
    at = pose.position
    return scale * np.stack([at.x + cosine * x - sine * y, at.y + sine * x + cosine * y])


def _shape(form: Form, points: FloatArray, color: Color, radius: float = 0.0) -> Shape:
    return Shape(form, points, "drawn", radius=radius, colour=_hex(color))


def _hex(color: Color) -> str:
    """Return a colour as text, "" for a grey: the page has ink of its own for these, in light and in dark."""
    levels = [round(255.0 * min(max(value, 0.0), 1.0)) for value in (color.r, color.g, color.b)]
    return "" if max(levels) - min(levels) < 24 else "#{:02x}{:02x}{:02x}".format(*levels)


def _size(shapes: Sequence[Shape]) -> int:
    return sum(4 + shape.points.shape[1] for shape in shapes)


def _same(a: tuple[float, Sequence[Shape]], b: tuple[float, Sequence[Shape]]) -> bool:
    return len(a[1]) == len(b[1]) and all(
        x[:1] + x[2:] == y[:1] + y[2:] and np.array_equal(x.points, y.points) for x, y in zip(a[1], b[1], strict=True)
    )
