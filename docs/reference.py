"""Writes docs/topics.md, docs/scenarios.md and docs/amcl.md from the code: `python -m docs.reference`.

Types, ranges and defaults are read from the structs themselves, units and meanings from the comments beside the fields.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

from dynpf_formats.shipped import known_topics, load, systems
from dynpf_protocol.journal import JournalEntry
from dynpf_protocol.messages import LogLevel
from dynpf_protocol.topics import TOPICS, Delivery, Topic
from dynpf_services.scenario.kinds import fact_kind, fact_names
from dynpf_services.scenario.schema import RunTable
from dynpf_services.scenario.vocabulary import whole_type
from msgspec import inspect as types

from docs.amcl_parameters import amcl
from docs.fields import Structs, anchor, described, inside, pieces_of, struct_of, table, type_text

__all__ = ["PAGES", "scenarios", "topics"]

TOPICS_HEAD = """\
<!-- Made by `make docs` from the code; do not edit. -->
# Topics and messages

Everything that travels between the processes and is recorded. Payloads are JSON; lengths are in metres, angles in
radians, times in seconds, unless a field says otherwise. NaN and infinity do not occur: they are refused when a message
is encoded. Unknown fields, and values outside a type or range, are refused when it is decoded. In poses, x points along
the width of the map and z upwards; everything in the plane is in the frame `map`.

A topic that *wakes* makes the nodes that read it step when it arrives in a realtime run; in lockstep every node steps
every tick. The names are those of nodes that have their usual names: what the node `estimator` calls `estimator/state`
is `other/state` of a node `other`, and `r1/estimator/state` of the robot `r1`.
Of a *fresh* topic a node takes only the newest message that has arrived, in a realtime run. What is *compared* makes
two runs the same.
"""

SCENARIOS_HEAD = """\
<!-- Made by `make docs` from the code; do not edit. -->
# Scenarios

A scenario is one TOML file that describes a whole run; `dynpf list` shows those that come along, and every command that
takes a scenario takes a path, too. `--set KEY=VALUE` overrides a key: `--set estimator.n=500`. A key that is not listed
here, or a value outside its range, is refused with the file, the key and what was expected.

Lengths are in metres, angles in radians, times in seconds, unless a key says otherwise; `_px` are pixels.
A node takes part in a run if its table is there. `kind` chooses between the nodes that can do the job, and between the
components of the estimator. A component whose other keys keep their defaults may be written as its kind alone:
`proposal = "optimal"`; and where a list of tables is expected, one may stand alone. Editors complete and check
scenarios by the schema that `dynpf schema` prints.

## The run
"""

NODES_AND_TABLES = """\
## Nodes, and the tables that they share

The tables `[simulator]`, `[vision]`, `[sensors]`, `[estimator]` and `[controller]` are nodes of these names. Any number
of others have a name of their own, `[nodes.NAME]`, and a `kind` of any section (`kind = "localization"`); a kind that
two sections have is named with its section, as in `rearrangement_estimator`. They take their turn in a tick by the
section of their kind, and within one each after those that it reads.

A node's topics begin with its name: an estimator `[nodes.ekf]` writes `ekf/state`, `ekf/particles` and so on. It reads
what it would read as the one of its kind, `sensors/odometry` say; `remap = { "sensors/odometry" = "wheels/odometry" }`
in its table gives it another topic for one of these names.

`robots = ["r1", "r2"]` names several robots; each table of `[robot]`, such as `[robot.estimator]`, then stands for a
node of each of them: `r1/estimator` and `r2/estimator`, whose topics are within the namespace of their robot
(`r1/sensors/odometry`, `r1/estimator/state`). `--set nodes.r1/estimator.n=500` sets a key of one alone, and
`--set robot.estimator.n=500` of all.

Tables that nodes share:
"""

OWN_NODES = """\
## Your own nodes, messages and sensors

`kind = "module:Name"` in a node's table makes it a class of yours, a subclass of `dynpf_lab.Node`, or of
`dynpf_lab.Sensor` for a sensor that reads the true state of a simulated robot. Its fields are the parameters that the
table gives. [examples/](../examples) has systems that are made so: each is complete in two files.

```toml
[nodes.guard]
kind = "watchdog:Watchdog"
limit = 0.5
```

```python
# watchdog.py, beside the scenario
from typing import NamedTuple

from dynpf_lab import Message, Node
from dynpf_protocol.messages import Estimate


class Alarm(Message, frozen=True, kw_only=True):
    schema_name = "watchdog.Alarm"
    since_s: float


class Watchdog(Node, frozen=True, kw_only=True):
    reads = ("estimator/state",)  # topics, or types of messages: then all topics of its robot that carry it
    writes = {"alarm": Alarm}  # of the node `guard`: guard/alarm
    limit: float = 0.5  # m

    class State(NamedTuple):
        bad_since_ns: int = -1

    def step(self, state, moment):
        estimate = moment.newest(Estimate)
        if estimate is None:
            return state, ()
        bad = estimate.covariance[0] + estimate.covariance[4] > self.limit**2
        since = -1 if not bad else state.bad_since_ns if state.bad_since_ns >= 0 else moment.stamp_ns
        alarm = [Alarm(since_s=(moment.stamp_ns - since) * 1e-9)] if bad else []
        return state._replace(bad_since_ns=since), alarm
```

- `step` is a function of its arguments alone: the state before and the moment in, the state after and messages out.
  Random numbers come from `moment.draws()`, keyed by seed, node and step. State is a NamedTuple with a default for each
  field, of plain values, messages and NumPy arrays; it is taken out, put back and digested without a line of yours.
- Messages are structs with a `schema_name`; their schema, codec, journal, recording, replay and comparison follow.
- `dynpf_lab.Every` says what is due at most once in so many seconds: `every: Every = Every(0.2)` as a parameter,
  `self.every.due(moment.stamp_ns, state.said_ns)` in a step, and the stamp at which it was last so in the state.
- A measurement model of yours takes messages of yours if its class attribute `reading` is their type.
- Modules are looked for beside the scenario's file and in the folders that `--code FOLDER` names, behind everything
  that is installed: a file of yours can break nothing of ours.
"""

OWN_COMPONENTS = """\
## Your own components

Where a table below says `kind = "package.module:Name"`, a class of yours can stand in the place of the library's: a
motion or measurement model, a resampling scheme, a proposal, a regularization, an adaptation, or a whole filter.

```toml
[estimator.motion]
kind = "drift.models:Drift"
rate = 0.05
```

```python
# drift/models.py
import msgspec


class DriftParams(msgspec.Struct, frozen=True):
    rate: float = 0.1  # m per square root of a second


class Drift:
    Params = DriftParams

    def __init__(self, params): ...
    def particles(self, poses, stream): ...
    def propagate(self, particles, control, stream): ...
```

- The other keys of the table are the parameters. If the class has a msgspec struct `Params`, they are checked by its
  types and ranges, and the class is called with the struct; without, it is called with the keys as keywords.
- It must have the methods of its part, as the protocols in `dynpf` define them: `MotionModel` (or `GaussianMotion`, for
  filters and proposals that need it), `MeasurementModel` (or `GaussianMeasurement`), `Resampling`, `Proposal`,
  `Regularization`, `Sizing` or `Recovery`. A filter has `start`, `predict` and `update`, as `ParticleFilter` has.
- The class attribute `uses` names what it is given besides, as keywords: of a motion or measurement model `landmarks`,
  `grid` and `segments`, the maps of the run; of a filter `motion`, `measurements`, `proposal` and `resampling`.
- A measurement model names the type of its readings in the class attribute `reading`: `RangeBearingReadings`,
  `UnlabelledReadings`, `Scan`, `RangeVector`, `Lines` or `Position`; or a type of messages of your own.
- A motion model is given a `Twist`, or a `Displacement` if its class attribute `control` is that type.
- Its bytes are as exact as what it calls. The library's own are the same on every machine; NumPy's `@`, `exp` or `sin`
  and those of `math` are not, but differ in the last digits from processor to processor, and a replay elsewhere shows
  it. `dynpf.portable` has the same with fixed bits, and [the library](library.md#a-model-of-ones-own) tells more.
- It draws from the stream that it is given and from nothing else, reads no clock and no file, and keeps no state
  between calls: else a replay is not the same run.

A class without the methods of its part is refused before it is called, and a module of Python's own, as in
`subprocess:Popen`, before it is imported. To import a module is to run it, and a scenario file is believed like a
program: look into one that a stranger wrote before you run it.

A recording holds the names of such modules and a digest of their source (of the whole package, if the module is in
one), but not the code. A recording is not believed: `dynpf replay` imports a module only if you allow it by its name,
`--allow-code drift.models` ([recordings](recording.md#a-recording-of-somebody-elses)). It refuses to go on
without the module, and says when it is not the one that was recorded. Processes that join a run must have the same.
"""


def topics() -> str:
    """Return the reference of topics and messages."""
    lines = [TOPICS_HEAD, "## Topics that any robot may have", "", *_rows(TOPICS.values())]
    for system in (system for system in systems() if hasattr(system, "TOPICS")):
        about = (system.__doc__ or "").partition(";")[0]
        lines += ["", f"## {about}", "", *_rows(load(system.TOPICS))]
    lines += [
        "",
        "A recording holds besides, for each node, the topic `journal/NODE` of type",
        f"[{JournalEntry.schema_name}](#{anchor(JournalEntry.schema_name)}).",
        "",
        "## Messages",
        "",
        "Types named `foxglove.` have the shape of Foxglove's own schemas.",
    ]
    named: dict[str, type] = {row.type.schema_name: row.type for row in known_topics().values()}
    named[JournalEntry.schema_name] = JournalEntry
    pieces: Structs = {}
    for name, kind in sorted(named.items()):
        info = struct_of(kind)
        pieces |= pieces_of(info)
        lines += ["", f"### {name}", "", *described(info, pieces)]
    lines += ["", "## Pieces of messages"]
    for name, info in sorted(pieces.items()):
        lines += ["", f"### {name}", "", *described(info, pieces)]
    lines += ["", f"Log levels: {', '.join(f'{level.value} {level.name.lower()}' for level in LogLevel)}.", ""]
    return "\n".join(lines)


def _rows(topics: Iterable[Topic]) -> Iterator[str]:
    """Yield the table of topics."""
    rows = (
        (
            f"`{row.name}`",
            f"[{row.type.schema_name}](#{anchor(row.type.schema_name)})",
            ", ".join(row.publishers),
            "yes" if row.wakes else "no",
            "fresh" if row.delivery is Delivery.FRESH else "reliable",
            "yes" if row.compared else "no",
            row.description,
        )
        for row in topics
    )
    yield from table(("Topic", "Type", "From", "Wakes", "Delivery", "Compared", "What it is"), rows)


def scenarios() -> str:
    """Return the reference of the keys of a scenario."""
    lines = [SCENARIOS_HEAD]
    info = struct_of(whole_type())
    lines += [*described(struct_of(RunTable), {}), "", NODES_AND_TABLES.rstrip(), "", *_shared(), ""]
    lines += [OWN_NODES.rstrip(), "", OWN_COMPONENTS.rstrip()]
    for path, inner in _sections(info, ""):
        kind = f', kind = "{inner.tag}"' if inner.tag is not None else ""
        lines += ["", f"## `{path}`{kind}", "", *described(inner, {})]
    return "\n".join([*lines, ""])


def _shared() -> list[str]:
    """Return the table of the tables that nodes share."""
    kinds = ((name, fact_kind(name)) for name in fact_names())
    rows = ((f"`{name}`", type_text(types.type_info(kind.type), {}), kind.about) for name, kind in kinds)
    return [*table(("Table", "Type", "What it is"), rows)]


def _sections(info: types.StructType, path: str) -> Iterator[tuple[str, types.StructType]]:
    """Yield the tables below a table, each with its name as it stands in the file, depth first."""
    for field in info.fields:
        found, many = inside(field.type)
        for inner in found:
            name = f"{path}.{field.name}".lstrip(".")
            yield (f"[[{name}]]" if many else f"[{name}]"), inner
            yield from _sections(inner, name)


PAGES = {
    Path(__file__).with_name("topics.md"): topics,
    Path(__file__).with_name("scenarios.md"): scenarios,
    Path(__file__).with_name("amcl.md"): amcl,
}


def _main() -> None:
    for path, page in PAGES.items():
        path.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    _main()
