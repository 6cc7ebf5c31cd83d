"""A run that goes on, as frames: what a page shows of its last moment, by what draws pages of recordings."""

from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

from dynpf_formats.recording.reader import Recording
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.messages import (
    CompressedImage,
    LandmarkReadings,
    LaserScan,
    LineReadings,
    Odometry,
    OdometryPose,
    PosesInFrame,
    PositionFix,
    SceneUpdate,
)
from dynpf_protocol.printable import printable
from dynpf_protocol.topics import Topic
from dynpf_runtime.plan import Plan, written_topics
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.schema import Scenario

from dynpf_experiments.pictures import packing
from dynpf_experiments.pictures.cameras import cameras_of
from dynpf_experiments.pictures.source import Budget, RunSource
from dynpf_experiments.pictures.tracks import readings_of
from dynpf_experiments.pictures.whole import whole_of

__all__ = ["LiveRun"]

NEWEST = (CompressedImage, LandmarkReadings, LaserScan, LineReadings, PosesInFrame, PositionFix, SceneUpdate)
"""Of what a frame shows the newest; of all else, such as poses, it shows what has come since the last frame."""

MOST_OFTEN, OVERLAP = 60, 3
"""Messages of a topic in a frame, and those of the frame before among them: errors take two true poses."""

NOT_SHOWN = (Odometry, OdometryPose)
"""What tells of a path only if all of it is there: where no node tells the path by odometry, a frame has none."""

_BUDGET = Budget(frames=2, clouds=2, readings=8, scenes=4, values=2 * MOST_OFTEN)


class _Heard(NamedTuple):
    """A message as a recording has it."""

    topic: str
    node: str
    boot: str
    sequence: int
    stamp_ns: int
    publish_ns: int
    payload: bytes


class _Header(NamedTuple):
    writes: Mapping[str, tuple[str, ...]]
    scenario: str


class _Moment:
    """The messages of the last moment, as those of a recording."""

    attachments = ()
    path = Path("live")

    def __init__(self, plan: Plan) -> None:
        self.topics: Mapping[str, Topic] = plan.graph.topics
        self.header = _Header(written_topics(plan), plan.text)
        self.schemas: dict[str, deque[_Heard]] = {}

    def messages(self, topic: str | None = None, node: str | None = None) -> Iterator[_Heard]:
        """Yield messages, of one topic or node if given."""
        for heard in self.schemas.values() if topic is None else (self.schemas.get(topic, ()),):
            yield from (each for each in heard if node in (None, each.node))

    def journals(self) -> tuple[tuple[str, str], ...]:
        """Return no journal."""
        return ()


class _LiveSource(RunSource):
    """The last moment as pages read it: seconds since the run's first tick."""

    def __init__(self, moment: _Moment, context: Context, span_ns: tuple[int, int]) -> None:
        super().__init__(cast(Recording, moment), _BUDGET)
        self.scenario, self.context, self.span_ns = context.scenario, context, span_ns


class LiveRun:
    """The last moment of a run of ``plan``, which is that of ``scenario``."""

    def __init__(self, scenario: Scenario, plan: Plan) -> None:
        self._plan = plan
        self._context = Context(scenario, "page")
        self._moment = _Moment(plan)
        self._origin_ns: int | None = None if plan.plays_log else 0
        self._stamp_ns = 0
        self.tick = -1

    def seconds(self, stamp_ns: int) -> float:
        """Return the time of a stamp, s since the run's first tick."""
        return round((stamp_ns - (self._origin_ns or 0)) * 1e-9, 3)

    def wants(self, topic: str) -> bool:
        """Return whether a frame shows messages of a topic."""
        row = self._plan.graph.topics.get(topic)
        return row is not None and row.compared and row.type not in NOT_SHOWN

    def hear(self, topic: str, envelope: Envelope, payload: bytes) -> None:
        """Take a message of the run; those of topics that no frame shows are left out."""
        if not self.wants(topic):
            return
        heard = self._moment.schemas.get(topic)
        if heard is None:
            newest = self._plan.graph.topics[topic].type in NEWEST
            heard = self._moment.schemas[topic] = deque(maxlen=1 if newest else MOST_OFTEN)
        node, boot, sequence, stamp_ns = envelope.node, envelope.boot, envelope.sequence, envelope.stamp_ns
        heard.append(_Heard(topic, node, boot, sequence, stamp_ns, envelope.publish_ns, payload))
        self._origin_ns = stamp_ns if self._origin_ns is None else self._origin_ns
        self._stamp_ns, self.tick = max(self._stamp_ns, stamp_ns), max(self.tick, envelope.tick)

    def frame(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return what moves, and what stays from frame to frame, as the data of a page has it."""
        origin_ns = self._origin_ns or 0
        source = _LiveSource(self._moment, self._context, (origin_ns, max(self._stamp_ns, origin_ns)))
        run = whole_of(source)
        drawing, tracks = run.drawing, [each for each in run.tracks if each.seconds.size]
        fixed = drawing.shapes
        moving = {
            "t": round(run.seconds, 3),
            "tick": self.tick,
            "tracks": [packing.track(each) for each in tracks],
            "clouds": [packing.cloud(each) for each in run.clouds],
            "readings": [packing.reading(each) for each in readings_of(source)],
            "layers": [packing.layer(each) for each in drawing.layers],
            "plots": [packing.plot(each, _BUDGET.values) for each in run.plots],
            "health": [
                {"node": printable(node, 80), "spans": [list(span) for span in spans]}
                for node, spans in run.health.items()
                if spans
            ],
            "cameras": [packing.camera(each) for each in cameras_of(source, drawing.circles) if each.frames],
        }
        staying = {
            "unit": drawing.unit.name,
            "bounds": list(packing.bounds_of(fixed, drawing.grids, [] if fixed or drawing.grids else tracks)),
            "grids": [packing.grid(each) for each in drawing.grids],
            "shapes": [packing.shape(each) for each in drawing.shapes],
        }
        self._forget()
        return moving, staying

    def _forget(self) -> None:
        """Forget what the next frame does not need."""
        for heard in self._moment.schemas.values():
            while len(heard) > OVERLAP:
                heard.popleft()
