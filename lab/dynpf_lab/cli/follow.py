"""``dynpf replay --follow``: a twin of a run that goes on, which executes every step again and compares every byte."""

import argparse
import json
import math
import os
import time
from collections.abc import Container, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynpf_protocol.errors import RunError, UsageError

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.going import Target, scenario_of, target_of

if TYPE_CHECKING:
    from dynpf_formats.recording.reader import Recording
    from dynpf_runtime.bus.listener import Frame, Listener
    from dynpf_runtime.bus.terminal import StopSignal
    from dynpf_runtime.follow import Divergence, Follower

__all__ = ["follow"]

_LOOK_S = 0.3
_QUIET_S = 1.0
_SETTLE_S = 10.0
"""How long it waits, after the run's end or a divergence, for what is still on its way: until nothing comes, at most
so long."""

_AT_ONCE = 64
"""Messages between two looks for steps that can be executed."""

_FILE_S = 30.0
"""How long a recording may take to have what was said before this process listened."""

_NICE = 10
"""What a run's own processes have to do comes first."""


def follow(options: argparse.Namespace) -> int:
    """Follow a run until it ends, print what was found, and return the exit code."""
    from dynpf_runtime.bus.listener import listening
    from dynpf_runtime.bus.terminal import StopSignal

    target = _target(options)
    if target.recording is None:
        # A snapshot may be anybody's work: no index in it leads a kernel out of an array. Read when numba is imported.
        os.environ["NUMBA_BOUNDSCHECK"] = "1"
    endpoint, keys = endpoint_of(options), credentials_of(options, "observer", quiet=True)
    with listening(endpoint, keys) as listener, StopSignal.installed() as stop:
        os.nice(_NICE)
        following = _Following(listener, stop, target)
        if not following.begin(endpoint, options.allow_code):
            return _told_nothing("stopped before it could listen to the run")
        ended = following.run()
    return _report(following.follower, ended, complete=following.complete, as_json=options.json)


def _target(options: argparse.Namespace) -> Target:
    """Return what the command line names; raises UsageError for an option that a run that goes on has no use for."""
    for option, given in (("--set", options.overrides), ("-o", options.output), ("--node", options.node)):
        if given:
            raise UsageError(f"{option}: a run that goes on is followed as it is, all of it; --follow goes without it")
    if options.at is not None or options.first is not None or options.last is not None:
        raise UsageError("--follow goes on to the end of the run: it goes without --from, --until and --at")
    return target_of(options)


class _Following:
    """A follower that is fed with what a listener hears, and with what a recording has of the time before."""

    def __init__(self, listener: "Listener", stop: "StopSignal", target: Target) -> None:
        self.follower: Follower
        self.complete: str | None = None  # what the recorder says of the run, once it is over
        self._listener, self._stop, self._target = listener, stop, target
        self._messages = 0
        self._shown_s = 0.0

    def begin(self, endpoint: str, allow_code: Container[str]) -> bool:
        """Build the twins of the run; return False if this process was asked to end before."""
        from dynpf_runtime.bus.terminal import say
        from dynpf_runtime.follow import Follower
        from dynpf_services.scenario.build import plan_of

        while (frame := self._listener.take(_LOOK_S)) is None:
            if self._stop.requested:
                return False
        text = self._content(frame, "scenario").payload.decode(errors="replace")
        plan = plan_of(scenario_of(self._target, text, endpoint, allow_code, "a twin"))
        if plan.text != text:
            named = self._target.folder or self._target.recording
            raise UsageError(
                f"{named or 'the modules here'}: the run at {endpoint} is of another scenario, or its modules have "
                "other sources there"
            )
        self.follower = Follower(plan, by_snapshots=self._target.recording is None)
        say("replay", f"following the run at {endpoint}")
        return True

    def run(self) -> str:
        """Follow the run and return why that is over."""
        from dynpf_runtime.progress import show_progress

        early: list[Frame] = []
        over, quiet, due_s = self._catch_up(early), 0, math.inf
        for heard in early:
            over = self._hear(heard) or over
        while over not in ("gone", "stopped") and not self.follower.settled:
            frame = self._listener.take(_LOOK_S)
            quiet = 0 if frame is not None else quiet + 1
            if frame is not None:
                over = self._hear(frame) or over
            if frame is None or self._messages % _AT_ONCE == 0:
                self.follower.advance()
                self._show()
            if self._stop.requested:
                over = "stopped"
            if self.complete is not None or self.follower.first is not None:
                due_s = min(due_s, time.monotonic() + _SETTLE_S)
                if quiet * _LOOK_S >= _QUIET_S or time.monotonic() > due_s:
                    break
        self.follower.advance()
        show_progress("")
        return over

    def _hear(self, frame: "Frame") -> str:
        """Take a frame, and return why there are no more, if that is so."""
        from dynpf_protocol.control import Recorded, decode_control
        from dynpf_protocol.errors import ProtocolError
        from dynpf_protocol.keys import RECORDED
        from dynpf_runtime.machines.events import Arrived

        self._messages += 1
        if frame.kind == "gone":
            return "gone"
        frame = self._content(frame, "arrived")
        if frame.key != RECORDED:
            self.follower.hear(Arrived(frame.key, frame.payload, frame.attachment))
            return ""
        try:
            recorded = decode_control(frame.payload, Recorded)
        except ProtocolError:
            return ""  # without keys it may be anybody's
        self.complete = "" if recorded.complete else recorded.reason or "incomplete"
        return "recorded"

    @staticmethod
    def _content(frame: "Frame", kind: str) -> "Frame":
        """Return a frame of a kind; raises UsageError or RunError for one that says why there is none."""
        if frame.kind == "failed":
            raise UsageError(frame.payload.decode(errors="replace"))
        if frame.kind == "dropped":
            raise RunError("the run goes faster than it can be executed again here, and messages were dropped")
        if frame.kind != kind:
            raise RunError("the router is gone")
        return frame

    def _catch_up(self, early: "list[Frame]") -> str:
        """Read the time before this process listened from the recording, if there was such a time.

        What is heard meanwhile goes into ``early``. Returns why there is no more, if that is so.
        """
        from dynpf_protocol.journal import decode_entry
        from dynpf_protocol.keys import JOURNAL, RECORDED

        nodes = self.follower.twins
        firsts: dict[str, int] = {}
        while len(firsts) < len(nodes):
            frame = self._listener.take(_LOOK_S)
            if self._stop.requested:
                return "stopped"
            if frame is None:
                continue
            early.append(frame)
            if frame.kind != "arrived" or frame.key == RECORDED:
                break
            if frame.key.startswith(JOURNAL) and (name := frame.key[len(JOURNAL) :]) in nodes:
                try:
                    firsts.setdefault(name, decode_entry(frame.payload).step)
                except ValueError:
                    continue
        path = self._target.recording
        if path is not None and path.is_file() and (any(firsts.values()) or len(firsts) < len(nodes)):
            self._read(path, firsts)
        return ""

    def _read(self, path: Path, firsts: "dict[str, int]") -> None:
        """Give the follower what a recording has, once that reaches the first steps that were heard."""
        from dynpf_formats.recording.reader import read_recording

        deadline_s = time.monotonic() + _FILE_S
        while True:
            recording = read_recording(path, allow_truncated=True)
            lacking = [name for name, step in firsts.items() if _steps(recording, name) <= step]
            if not lacking:
                break
            if time.monotonic() > deadline_s:
                raise UsageError(
                    f"{path}: does not have what {lacking[0]} did before step {firsts[lacking[0]]}; is it the "
                    "recording of this run?"
                )
            time.sleep(_LOOK_S)  # the recorder writes four times a second
        self._feed(recording)

    def _feed(self, recording: "Recording") -> None:
        from dynpf_protocol.envelope import Envelope
        from dynpf_protocol.journal import JOURNAL_PREFIX, decode_entry

        for record in recording.records:
            if record.topic == JOURNAL_PREFIX + record.node:
                self.follower.entry(record.node, record.boot, decode_entry(record.payload))
                self.follower.advance()
                self._show()
            else:
                envelope = Envelope(record.node, record.boot, record.sequence, 0, record.stamp_ns, record.publish_ns)
                self.follower.message(record.topic, envelope, record.payload)

    def _show(self) -> None:
        from dynpf_runtime.progress import show_progress

        if time.monotonic() - self._shown_s > _LOOK_S:
            self._shown_s = time.monotonic()
            steps = sum(twin.steps for twin in self.follower.twins.values())
            show_progress(f"{steps} steps executed again, all the same")


def _steps(recording: "Recording", node: str) -> int:
    """Return how many steps of a node a recording has."""
    boots = [boot for name, boot in recording.journals() if name == node]
    return sum(1 for boot in boots for _ in recording.journal(node, boot))


def _report(follower: "Follower", ended: str, *, complete: str | None, as_json: bool) -> int:
    twins, first = follower.twins, follower.first
    steps, messages = (sum(getattr(twin, name) for twin in twins.values()) for name in ("steps", "messages"))
    pending = 0 if ended == "stopped" else sum(twin.pending for twin in twins.values())
    cut_off = ended == "gone" and complete is None
    same = first is None and all(twin.begun for twin in twins.values()) and not pending and not cut_off
    if as_json:
        counts = {
            name: {"steps": twin.steps, "messages": twin.messages, "from": twin.begun} for name, twin in twins.items()
        }
        document = {"same": same, "first": _difference(first), "steps": steps, "messages": messages, "counts": counts}
        print(
            json.dumps(
                document | {"unchecked": pending, "refused": follower.refused, "end": "diverged" if first else ended}
            )
        )
        return 0 if same else 1
    if first is not None:
        found = _difference(first)
        assert found is not None
        where = "node {node}, tick {tick}, {topic} {sequence}, {field}".format(**found)
        at = "" if first.offset is None else f", byte {first.offset}"
        print(f"first divergence: {where}{at}: recorded {found['a']!r}, executed again {found['b']!r}")
    print(f"{'same' if same else 'executed'}: {steps} steps, {messages} messages, {_since(follower)}")
    if pending:
        print(f"{pending} steps could not be executed again: not all that they read or made has come here")
    if follower.refused:
        print(f"{follower.refused} messages were none of the run's, and were left out")
    if ended == "stopped":
        print("stopped by the user before the end of the run")
    elif cut_off:
        print("the router has gone, or has dropped this process: how the run went on was not heard")
    elif complete:
        print(f"the run itself is incomplete: {complete}")
    return 0 if same else 1


def _since(follower: "Follower") -> str:
    """Return from where on the nodes were executed again."""
    begun = {name: twin.begun for name, twin in follower.twins.items()}
    if all(where == [0] for where in begun.values()):
        return "from the run's start"
    told = [f"{name} from step {_listed(where)}" if where else f"{name} not at all" for name, where in begun.items()]
    return f"{', '.join(told)}; a twin that joins late begins with the next snapshot, or reads RUN.mcap from its start"


def _listed(where: Sequence[int]) -> str:
    return " and again from step ".join(map(str, where))


def _difference(first: "Divergence | None") -> dict[str, Any] | None:
    if first is None:
        return None
    found = first.mismatch._asdict()
    a, b = (_plain(found.pop(name)) for name in ("recorded", "replayed"))
    return {**found, "byte": first.offset, "a": a, "b": b}


def _plain(value: Any) -> Any:
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def _told_nothing(text: str) -> int:
    print(f"nothing was executed again: {text}")
    return 1
