"""A recording's scenario as its readers get it: whatever stands in it, nothing is imported and nothing opened."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import pytest
from dynpf_formats import regular_files
from dynpf_formats.recording.attachments import FOLDER
from dynpf_formats.recording.code import recorded_code
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.index import MessageIndex
from dynpf_formats.recording.info import title_of
from dynpf_formats.recording.reader import Recording
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario import user_code
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_services.scenario.replay import changed_code
from dynpf_services.scenario.schema import resolved_json
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.recording.recorded_runs import HEADER

BASES = [
    json.loads(resolved_json(load_scenario(name)))
    for name in ("room-scan", "landmark-room", "colon-own-maps", "landmark-filters")
]
KINDS = ("subprocess:Popen", "os:system", "this:X", "builtins:exec", "evil:Model", "a.b:C", "package.module:Name")
PATHS = ("/etc/passwd", "/dev/zero", "../x.png", "x.png", "sub/x.yaml", "x.yaml", "", "/", "\0")
NASTY = st.one_of(
    st.sampled_from(KINDS),
    st.builds(lambda kind: {"kind": kind, "name": "evil:Model", "parameters": {}}, st.sampled_from(KINDS)),
    st.builds(lambda kind: [{"kind": kind}], st.sampled_from(KINDS)),
    st.sampled_from(PATHS),
    st.builds(
        lambda kind, path: {"kind": kind, "file": path},
        st.sampled_from(["bitmap", "occupancy"]),
        st.sampled_from(PATHS),
    ),
    st.builds(lambda path: [path], st.sampled_from(PATHS)),
    st.builds(lambda kind: {kind.partition(":")[0]: "0" * 64}, st.sampled_from(KINDS)),
    st.sampled_from([None, 1e999, -1, "x" * 1000, {}, []]),
)
ADDED = (
    "estimator.motion",
    "estimator.filter",
    "estimator.measurement",
    "estimator.adaptation",
    "map",
    "maps",
    "user_code",
)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield (*path, key)
        yield from places(child, (*path, key))


def changed(raw: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    copy = list(raw) if isinstance(raw, list) else dict(raw)
    copy[path[0]] = changed(copy[path[0]] if len(path) > 1 else None, path[1:], value)
    return copy


PLACES = [(base, place) for base in BASES for place in [*places(base), *(tuple(key.split(".")) for key in ADDED)]]
YAML = b"image: /etc/passwd\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"


def recording(scenario: str) -> Recording:
    return Recording(
        schemas={},
        path=Path("run.mcap"),
        header=msgspec.structs.replace(HEADER, scenario=scenario),
        attachments=(Attachment(name=f"{FOLDER}x.yaml", media_type="", data=YAML),),
        end=None,
        truncated=False,
        index=MessageIndex(Path("run.mcap")),
    )


class TouchedError(BaseException):
    """Something was used that may not be; nobody is to catch it as an error of a module."""


class Untouchable:
    """Stands for what may not be used."""

    def __getattr__(self, name: str) -> NoReturn:
        raise TouchedError(f"{name} was used")


def opened(path: Path, *_: object) -> NoReturn:
    raise TouchedError(f"{path} was opened")


@contextmanager
def guarded() -> Iterator[None]:
    """Let nothing be imported by name, and no file be read."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(user_code, "importlib", Untouchable())
        patch.setattr(Path, "read_bytes", opened)
        patch.setattr(Path, "open", opened)
        patch.setattr(regular_files, "open_regular", opened)
        yield


@settings(max_examples=120, deadline=None)
@given(st.sampled_from(PLACES), NASTY, st.sampled_from([(), ("estimator.n=9",), ("map.kind=bitmap",), ("title=x",)]))
def test_nothing_is_imported_or_opened_whatever_stands_in_it(
    place: tuple[Any, tuple[Any, ...]], value: Any, overrides: tuple[str, ...]
) -> None:
    one = recording(json.dumps(changed(*place, value)))
    with guarded():
        named = recorded_code(one)
        try:
            scenario = recorded_scenario(one, overrides)
        except ScenarioError as error:
            assert str(error).startswith("run.mcap: ") or "--set" in str(error)
            return
        assert not scenario.user_code
        assert {one.text for one in scenario.user_classes} == {one.text for one in named}
        if named:
            with pytest.raises(ScenarioError):
                Context(scenario, "estimator").user_classes()


def test_what_may_not_be_used_is_noticed() -> None:
    """The control of the test above."""
    one = recording(json.dumps(changed(BASES[1], ("estimator", "motion"), {"kind": "evil:Model"})))
    with guarded():
        with pytest.raises(TouchedError, match="util was used"):
            recorded_scenario(one, (), ["evil"])
        with pytest.raises(TouchedError, match=r"mine\.png was opened"):
            recorded_scenario(one, ["map={kind='bitmap', file='mine.png'}"])


@pytest.mark.parametrize("text", ["", "[1]", "{", "null", "[" * 100_000, '{"a":' * 100_000, "\ud800"])
def test_a_scenario_that_is_none_is_told_in_one_line(text: str) -> None:
    assert recorded_code(recording(text)) == ()
    assert title_of(recording(text)) == "untitled"
    with pytest.raises(ScenarioError, match=r"run.mcap: its scenario (cannot be read|is a|is nested too deeply)"):
        recorded_scenario(recording(text))


def test_no_digests_of_user_code_are_none() -> None:
    one = recording(json.dumps(changed(BASES[1], ("user_code",), None)))
    assert list(changed_code(one, recorded_scenario(one))) == []
