"""The kinds of attack: what a stranger says, and when.

A kind is *forged* if nothing but a certificate tells what it says from what the true process says. Without
certificates such a run need not be what it would have been, but it has to say so.
"""

from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from random import Random
from typing import NamedTuple

from dynpf_protocol.control import Act as Asked
from dynpf_protocol.control import Pace, encode_control
from dynpf_protocol.journal import Consumed, Produced
from dynpf_protocol.keys import (
    ACT,
    AGAIN,
    ALIVE,
    BEAT,
    CONTROL,
    DATA,
    JOURNAL,
    READY,
    RECORDED,
    RUN,
    SCENARIO,
    STOP,
    TICK,
    data_key,
)
from dynpf_protocol.recall import Piece, encode_recall
from dynpf_runtime.machines.effects import Answer, Declare, Put

from checks.attacks.spy import SOURCE, Spy

__all__ = ["KINDS", "Act", "Delete", "Kind", "Silent", "Undeclare", "When"]


class Undeclare(NamedTuple):
    """Withdraw a liveliness token."""

    key: str


class Silent(NamedTuple):
    """Take queries of ``key`` and never answer."""

    key: str


class Delete(NamedTuple):
    """Publish that ``key`` is deleted."""

    key: str


Act = Put | Declare | Answer | Undeclare | Silent | Delete


class When(Enum):
    """When a stranger acts."""

    JOINING = "once, before the run has begun"
    MIDDLE = "once, in the middle of the run"
    THROUGHOUT = "after each message, from the middle of the run on"


class Kind(NamedTuple):
    """One kind of attack."""

    name: str
    act: Callable[[Spy], Iterable[Act]]
    when: When = When.MIDDLE
    forged: bool = False


STATE, TRUTH, COMMAND = "estimator/state", "truth/robot", "controller/command"
_OTHERS = ("other", "estimator", "recorder", "a/b/c")
_CONSUMED = Consumed("nobody", "boot", "no/topic", 2**40)
_PREFIXES = (DATA, TICK, JOURNAL, BEAT, CONTROL, STOP)
_NAMES = ("simulator", "sensors", "estimator", "controller", "recorder", "router")
ESC = "\x1b[2J\x1b]0;owned\x07\r\nrun.mcap is complete"


def _each(put: Callable[[Spy, str], Put]) -> Callable[[Spy], Iterator[Act]]:
    """Return an act that says something on each of three topics."""
    return lambda spy: (put(spy, topic) for topic in (STATE, TRUTH, COMMAND))


def _ends(put: Callable[[Spy, str], Put]) -> Callable[[Spy], Iterator[Act]]:
    """Return an act that says something in the name of each node that has ended a tick."""
    return lambda spy: (put(spy, node) for node in list(spy.ends))


def _again(prefix: str, times: int = 1) -> Callable[[Spy], Iterator[Act]]:
    """Return an act that sends all again that was heard under a key."""
    return lambda spy: (Put(*one) for one in list(spy.heard) * times if one.key.startswith(prefix))


def _said_again(node: str, put: Put) -> Put:
    """Return what a node says again, to the recorder."""
    return Put(AGAIN + node, encode_recall(Piece(*put)))


def _crossed(prefix: str) -> Callable[[Spy], Iterator[Act]]:
    """Return an act that sends old messages under the newest attachments."""

    def act(spy: Spy) -> Iterator[Act]:
        heard = [one for one in spy.heard if one.key.startswith(prefix)]
        for older, newer in zip(heard, reversed(heard), strict=True):
            yield Put(newer.key, older.payload, newer.attachment)

    return act


def _noise(spy: Spy) -> Iterator[Act]:
    random = Random(len(spy.heard))
    keys = [RECORDED, *{one.key for one in spy.heard}, *(STOP + name for name in spy.boots)]
    for key in sorted(keys) * 20:
        yield Put(key, random.randbytes(random.randrange(200)), random.randbytes(random.randrange(60)))


def _cut(spy: Spy) -> Iterator[Act]:
    """Yield each key's last message with its end cut off."""
    for one in {one.key: one for one in spy.heard}.values():
        for share in (0.3, 0.9):
            yield Put(one.key, one.payload[: int(len(one.payload) * share)], one.attachment)
            yield Put(one.key, one.payload, one.attachment[: int(len(one.attachment) * share)])


_ROLE = (
    Kind("unknown topics", lambda _: (Put(f"{DATA}no/{number}", b"{}") for number in range(2000))),
    Kind("unknown keys", lambda _: (Put(f"{RUN}else/{n}", b"x") for n in range(500))),
    Kind("unknown sender", _each(lambda spy, topic: spy.data(topic, node="stranger"))),
    Kind("data of another boot", _each(lambda spy, topic: spy.data(topic, boot="another"))),
    Kind("flood of data of another boot", lambda spy: [spy.data(STATE, boot=f"b{n}") for n in range(3000)]),
    Kind("another's data, said again", lambda spy: [_said_again("sensors", spy.data(STATE))]),
    Kind("nothing, said again", lambda _: [Put(f"{AGAIN}sensors", b""), _said_again("sensors", Put("x", b"", b""))]),
    Kind("end of tick of another boot", _ends(lambda spy, node: spy.end(node, boot="another", last=True))),
    Kind("entry of another boot", _ends(lambda spy, node: spy.entry(node, of={"boot": "another"}))),
    Kind("stop of another boot", lambda spy: [spy.stop(name, "another") for name in (*spy.boots, "nobody")]),
    Kind("recorded of another boot", lambda spy: [spy.recorded(done, "another") for done in (True, False)]),
    Kind("beats of another boot", lambda spy: [spy.beat(name, 10**6, "another") for name in spy.boots]),
    Kind("topic of another node", lambda spy: [spy.data(STATE, node="sensors", boot=spy.boot("sensors"))]),
    Kind("record of a log that is not played", lambda spy: [_record(spy)]),
    Kind("the recorder's own topics", lambda spy: [_recorders(spy, name) for name in ("log", "recorder/gap")]),
    Kind("end of tick under another key", lambda spy: [spy.end(SOURCE, key=key, last=True) for key in _OTHERS]),
    Kind("end of tick of no node", lambda spy: [_nobodys(spy, name) for name in ("recorder", "router")]),
    Kind("end of tick that promises foreign topics", _ends(lambda spy, node: spy.end(node, counts={"vision/x": 1}))),
    Kind("end of tick that promises 10^9", _ends(lambda spy, node: spy.end(node, counts={f"event/{node}": 10**9}))),
    Kind("end of tick with another step", _ends(lambda spy, node: spy.end(node, step=0))),
    Kind("end of tick far in time", _ends(lambda spy, node: spy.end(node, stamp_ns=2**62))),
    Kind("end of tick back in time", _ends(lambda spy, node: spy.end(node, stamp_ns=0))),
    Kind("data far in time", _each(lambda spy, topic: spy.data(topic, stamp_ns=2**62))),
    Kind("entry under another key", lambda spy: [spy.entry(SOURCE, key=key) for key in _OTHERS]),
    Kind("entry that makes foreign topics", _ends(lambda spy, node: spy.entry(node, produced=(Produced("x/y", 0),)))),
    Kind("entry that reads foreign topics", _ends(lambda spy, node: spy.entry(node, consumed=(_CONSUMED,)))),
    Kind("entry of another step than its envelope", _ends(lambda spy, node: spy.entry(node, of={"sequence": 10**6}))),
)


def _record(spy: Spy) -> Put:
    put = spy.data(TRUTH, node="log", boot=spy.boot(SOURCE), ahead=0)
    return put._replace(key=f"{DATA}log/truth")


def _recorders(spy: Spy, topic: str) -> Put:
    put = spy.data(TRUTH, node="recorder", boot=spy.boot("recorder"), ahead=0)
    return put._replace(key=data_key(topic, "recorder"))


def _nobodys(spy: Spy, name: str) -> Put:
    return spy.end(SOURCE, key=name, node=name, boot=spy.boot(name), last=True)


_ORDER = (
    Kind("data two sequences ahead", _each(lambda spy, topic: spy.data(topic, ahead=3, ticks=3))),
    Kind("data 10^6 sequences ahead", _each(lambda spy, topic: spy.data(topic, ahead=10**6))),
    Kind("data of the last sequence", _each(lambda spy, topic: spy.data(topic, sequence=2**32 - 1))),
    Kind("data a thousand ticks ahead", _each(lambda spy, topic: spy.data(topic, ticks=1000))),
    Kind("old sequences with other content", _each(lambda spy, topic: spy.data(topic, ahead=-8, ticks=-8))),
    Kind("sequence 0 of long ago", _each(lambda spy, topic: spy.data(topic, sequence=0, tick=0, stamp_ns=0))),
    Kind("all data again", _again(DATA, 3)),
    Kind("all ends of ticks again", _again(TICK, 3)),
    Kind("all journal entries again", _again(JOURNAL, 3)),
    Kind("everything again", _again("dynpf/", 2)),
    Kind("old content under new attachments", _crossed(f"{DATA}sensors/odometry"), forged=True),
    Kind("ends of future ticks without messages", lambda spy: _future_ends(spy, last=False)),
    Kind("last ends of future ticks", lambda spy: _future_ends(spy, last=True)),
    Kind("old ends of ticks with other counts", _ends(lambda spy, node: spy.end(node, ticks=-8, counts={}))),
    Kind("old last ends of ticks", _ends(lambda spy, node: spy.end(node, ticks=-8, last=True))),
    Kind("journal entries ahead", _ends(lambda spy, node: spy.entry(node, steps=50, last=True))),
    Kind("old journal entries that differ", _ends(lambda spy, node: spy.entry(node, steps=-8, state="0" * 64))),
    Kind("beats from the future", lambda spy: [spy.beat(name, 10**9) for name in spy.boots]),
)


def _future_ends(spy: Spy, *, last: bool) -> Iterator[Act]:
    for node in list(spy.ends):
        for ticks in range(100, 200):  # seconds ahead: not even a late one is the next
            yield spy.end(node, ticks=ticks, counts={}, last=last)


def _next_ends(spy: Spy) -> Iterator[Act]:
    """Yield ends of ticks that may drive the others on, one tick after the other."""
    for ticks in range(1, 100):
        for node in list(spy.ends):
            yield spy.end(node, ticks=ticks, counts={})


def _operator(spy: Spy) -> Iterator[Act]:
    yield Declare(f"{ALIVE}operator/x")
    yield spy.stop("operator", "x")


def _acts(_spy: Spy) -> Iterator[Act]:
    """What an operator would ask for, by nobody who is there."""
    place = b'{"x":0,"y":0,"theta":0}'
    for said in (
        Asked("operator", "x", 0, "operator/place", place),
        Asked("operator", "x", 1, pace=Pace(paused=True)),
        Asked(SOURCE, "x", 2, "operator/place", place),
    ):
        yield Put(ACT + said.node, encode_control(said))
    yield Put(f"{ACT}operator", b"?")
    yield Put(f"{ACT}operator", bytes(2**20))


_THROUGHOUT = When.THROUGHOUT
_FORGED = (
    Kind("the next data, forged", _each(lambda spy, topic: spy.data(topic)), _THROUGHOUT, forged=True),
    Kind("one message more than was sent", lambda spy: [spy.data("estimator/scene")], forged=True),
    Kind(
        "the next data, that cannot be read",
        _each(lambda spy, topic: spy.data(topic, payload=b"?")),
        _THROUGHOUT,
        forged=True,
    ),
    Kind("the next data, nested deeply", lambda spy: [spy.data(STATE, payload=b"[" * 10**5)], _THROUGHOUT, forged=True),
    Kind("the next end of tick, empty", _ends(lambda spy, node: spy.end(node, counts={})), _THROUGHOUT, forged=True),
    Kind("the next hundred ends of ticks, empty", _next_ends, forged=True),
    Kind("the next end of tick, the last", _ends(lambda spy, node: spy.end(node, last=True)), forged=True),
    Kind(
        "the next end of tick, with 1000 messages",
        _ends(lambda spy, node: spy.end(node, counts=dict.fromkeys(spy.ends[node].counts, 1000))),
        _THROUGHOUT,
        forged=True,
    ),
    Kind("the next journal entry, empty", _ends(lambda spy, node: spy.entry(node, produced=())), forged=True),
    Kind("stop in the source's name", lambda spy: [spy.stop(SOURCE)]),
    Kind("stop in a node's name", lambda spy: [spy.stop("estimator", reason=ESC)], forged=True),
    Kind("stop as an operator", _operator, forged=True),
    Kind("acts of no operator", _acts),
    Kind("recorded, incomplete", lambda spy: [spy.recorded(False, reason=ESC)]),
    Kind("recorded, complete", lambda spy: [spy.recorded(True)]),
    Kind("recorded, at each message", lambda spy: [spy.recorded(True)], _THROUGHOUT, forged=True),
)


_BYTES = (
    Kind("34 MB on log", lambda spy: [_large(spy, "log", 34 * 2**20)]),
    Kind("17 MB of data", lambda spy: [_large(spy, STATE, 17 * 2**20)]),
    Kind("17 MB as an end of tick", lambda _: [Put(f"{TICK}{SOURCE}", bytes(17 * 2**20))]),
    Kind("17 MB as a request to stop", lambda _: [Put(f"{STOP}{SOURCE}", bytes(17 * 2**20))]),
    Kind("17 MB as an attachment", lambda _: [Put(DATA + STATE, b"{}", bytes(17 * 2**20))]),
    Kind("keys of 10,000 characters", lambda _: [Put(f"{DATA}{'x' * 10_000}/{n}", b"{}") for n in range(20)]),
    Kind("noise on every key", _noise),
    Kind("messages cut off", _cut),
    Kind("nothing on every key", lambda spy: [Put(key, b"") for key in sorted({one.key for one in spy.heard})]),
    Kind("control characters in keys", lambda _: [Put(f"{where}{ESC}", ESC.encode()) for where in _PREFIXES]),
    Kind("control characters in boots", _each(lambda spy, topic: spy.data(topic, boot=ESC[:60]))),
    Kind("every key at once", lambda _: [Put(f"{where}**", b"x") for where in _PREFIXES]),
    Kind("deletions", lambda spy: [Delete(key) for key in sorted({one.key for one in spy.heard})]),
)


def _large(spy: Spy, topic: str, size: int) -> Put:
    name = topic if topic in spy.messages else TRUTH
    return spy.data(name, payload=b" " * size, ahead=0)._replace(key=data_key(topic, spy.messages[name][0].node))


_TOKENS = (
    Kind("a token of a node's name held", lambda spy: [Declare(f"{ALIVE}{name}/x") for name in list(spy.boots)]),
    Kind("a token of readiness held", lambda spy: [Declare(f"{READY}{name}/x") for name in list(spy.boots)]),
    Kind(
        "a flood of tokens", lambda spy: [Declare(f"{ALIVE}{name}/x{n}") for name in list(spy.boots) for n in range(60)]
    ),
    Kind("tokens that come and go", lambda _: _flapping(f"{ALIVE}estimator/x", 200)),
    Kind(
        "a node's own token, declared and withdrawn",
        lambda spy: _flapping(f"{ALIVE}estimator/{spy.boot('estimator')}", 3),
    ),
    Kind("tokens of nobody", lambda _: [Declare(f"{ALIVE}{name}") for name in ("nobody/x", "a/b/c/d", ESC[3:5])]),
    Kind("tokens of readiness before the run", lambda _: [Declare(f"{READY}{n}/x") for n in _NAMES], When.JOINING),
    Kind("all names taken before the run", lambda _: _taken(), When.JOINING, forged=True),
)


def _taken() -> Iterator[Act]:
    for name in _NAMES:
        yield from (Declare(f"{ALIVE}{name}/0"), Declare(f"{READY}{name}/0"))


def _flapping(key: str, times: int) -> Iterator[Act]:
    for _ in range(times):
        yield Declare(key)
        yield Undeclare(key)


_ANSWERS = tuple(
    Kind(f"the scenario answered: {what}", lambda _, answer=answer: [Answer(SCENARIO, answer)], When.JOINING)  # type: ignore[misc]
    for what, answer in {
        "no UTF-8": b"\xff\xfe",
        "no JSON": b"no JSON",
        "nested deeply": b"[" * 100_000,
        "another one": b'{"map": "\x1b[2J"}',
        "nothing": b"",
        "20 MB": b" " * 20 * 2**20,
    }.items()
)

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        *_ROLE,
        *_ORDER,
        *_FORGED,
        *_BYTES,
        *_TOKENS,
        *_ANSWERS,
        Kind("the scenario never answered", lambda _: [Silent(SCENARIO)], When.JOINING),
    )
}
