import argparse
import json
import re
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from dynpf_formats.recording.doctor import Finding, Severity, examine
from dynpf_lab.cli import diff, doctor, info, recover
from dynpf_protocol.envelope import Envelope
from dynpf_protocol.errors import DynpfError
from mcap.reader import make_reader

from tests.unit.recording.recorded_runs import HEADER, Sent, changed, lockstep, write

Run = Callable[..., tuple[int, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*words: str | Path) -> tuple[int, str]:
        parser = argparse.ArgumentParser()
        subparsers = parser.add_subparsers(required=True)
        for command in (info, doctor, recover, diff):
            command.add_arguments(subparsers.add_parser(command.__name__.rpartition(".")[2]))
        args = parser.parse_args([str(word) for word in words])
        code = args.run(args)
        return code, capsys.readouterr().out

    return call


def test_info(run: Run, tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", lockstep(5))
    code, printed = run("info", path, "--json")
    summary = json.loads(printed)
    assert code == 0
    assert (summary["title"], summary["seed"], summary["ticks"], summary["messages"]) == ("Three nodes", 7, 5, 20)
    assert (summary["complete"], summary["gaps"], summary["duration_s"]) == (True, 0, 0.2)
    assert summary["topics"]["truth/robot"]["messages"] == 5
    assert summary["attachments"] == {"files/map.pgm": 256}
    code, printed = run("info", path)
    assert code == 0
    assert "Three nodes, seed 7" in printed
    assert summary["content_digest"] in printed
    assert summary["platform_differs"] in printed
    assert summary["platform_differs"].startswith("recorded with ")


def test_info_tells_that_a_file_was_cut_off(run: Run, tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", lockstep(5), flush_every=10, close=False)
    code, printed = run("info", path, "--json")
    summary = json.loads(printed)
    assert code == 0
    assert (summary["truncated"], summary["complete"], summary["messages"]) == (True, False, 18)


def test_doctor_of_a_healthy_recording(run: Run, tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", lockstep(5))
    assert run("doctor", path) == (0, f"{path}: whole and complete\nnot signed\n")
    assert json.loads(run("doctor", path, "--json")[1]) == {
        "healthy": True,
        "findings": [],
        "code": [],
        "signed": None,
        "restarts": [],
        "resumable": False,
    }


def without(sent: list[Sent], topic: str, sequence: int) -> list[Sent]:
    return changed(sent, topic, sequence, lambda _: None)


def extra(topic: str, node: str, payload: bytes = b"{}") -> list[Sent]:
    return [*lockstep(3), Sent(topic, Envelope(node, "b", 0, 0, 0, 0), payload)]


@pytest.mark.parametrize(
    ("sent", "where", "what"),
    [
        (without(lockstep(5), "diagnostics", 2), "diagnostics", "missing: sequence 2 of estimator"),
        (
            without(lockstep(5), "truth/robot", 4),
            "journal/sensors",
            "1 references .* truth/robot 4 of simulator, consumed",
        ),
        (without(lockstep(5), "truth/robot", 4), "journal/simulator", "truth/robot 4 of simulator, produced in step 4"),
        (without(lockstep(5), "truth/robot", 4), "end of run", "not complete: the journal refers to"),
        (without(lockstep(5), "journal/sensors", 2), "journal/sensors", "missing: step 2"),
        (extra("log", "vision", b'{"level":9}'), "log", "1 unreadable messages of vision, first sequence 0: log: "),
        (extra("log", "stranger"), "log", "sent by 'stranger'; expected simulator"),
        ([*lockstep(2), *lockstep(2)[:1]], "truth/robot", "1 messages of simulator were recorded twice"),
        (
            [*lockstep(2), lockstep(2)[0]._replace(payload=lockstep(2)[7].payload)],
            "truth/robot",
            "1 sequence numbers of simulator stand for two different messages",
        ),
    ],
)
def test_doctor_finds(run: Run, tmp_path: Path, sent: list[Sent], where: str, what: str) -> None:
    path = write(tmp_path / "run.mcap", sent)
    findings = [found for found in examine(path) if found.where == where and re.search(what, found.what)]
    assert len(findings) == 1
    code, printed = run("doctor", path)
    assert code == 1
    assert findings[0].what in printed


@pytest.mark.parametrize("sequence", [0, 2])
def test_what_is_not_compared_and_missing_is_odd_and_nothing_else_is_wrong(tmp_path: Path, sequence: int) -> None:
    (found,) = examine(write(tmp_path / "run.mcap", without(lockstep(5), "diagnostics", sequence)))
    assert (found.severity, found.where) == (Severity.WARNING, "diagnostics")
    assert found.what.endswith("; this topic is not compared")


def test_doctor_of_something_else(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_text("hello, world")
    code, printed = run("doctor", path, "--json")
    assert code == 2
    (finding,) = json.loads(printed)["findings"]
    assert finding["severity"] == "unreadable"
    assert examine(path) == [Finding(severity=Severity.UNREADABLE, what=finding["what"], where=str(path))]


def test_recover(run: Run, tmp_path: Path) -> None:
    killed = write(tmp_path / "killed.mcap", lockstep(5), flush_every=10, close=False)
    code, printed = run("recover", killed)
    assert code == 0
    assert (
        "killed.recovered.mcap: 30 messages kept, the last at 0.200 s; incomplete, recovered: the file ends" in printed
    )
    mended = tmp_path / "killed.recovered.mcap"
    with mended.open("rb") as stream:
        assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) == 30
    with pytest.raises(DynpfError, match="the file exists") as refused:
        run("recover", killed, "-o", mended)
    assert refused.value.exit_code == 2
    code, printed = run("recover", killed, "-o", tmp_path / "second.mcap", "--json")
    assert (code, json.loads(printed)["kept"]) == (0, 30)


def test_diff(run: Run, tmp_path: Path) -> None:
    sent = lockstep(5)
    other = changed(sent, "truth/robot", 2, lambda one: one._replace(payload=one.payload.replace(b"0.5", b"0.6")))
    a, b = write(tmp_path / "a.mcap", sent), write(tmp_path / "b.mcap", other)
    assert run("diff", a, a) == (0, "same: 15 messages\n")
    code, printed = run("diff", a, b)
    assert code == 1
    assert "tick 2, node simulator, truth/robot 2, field y" in printed
    code, printed = run("diff", a, b, "--json")
    difference = json.loads(printed)
    assert (code, difference["same"]) == (1, False)
    assert difference["first"] == {
        "node": "simulator",
        "topic": "truth/robot",
        "tick": 2,
        "sequence": 2,
        "field": "y",
        "a": 0.5,
        "b": 0.6,
    }
    assert difference["counts"]["truth/robot"] == {"a": 5, "b": 5, "differ": 1}
    assert difference["platform"] == ""


def test_diff_tells_that_runs_of_one_scenario_were_made_on_different_platforms(run: Run, tmp_path: Path) -> None:
    sent = lockstep(5)
    other = changed(sent, "truth/robot", 2, lambda one: one._replace(payload=one.payload.replace(b"0.5", b"0.6")))
    provenance = msgspec.structs.replace(HEADER.provenance, platform={"system": "Plan 9"})
    header = msgspec.structs.replace(HEADER, provenance=provenance)
    a, b = write(tmp_path / "a.mcap", sent), write(tmp_path / "b.mcap", other, header=header)
    told = f"recorded with system Linux, {b} Plan 9; bytes should be the same all the same: please report"
    assert told in run("diff", a, b)[1]
    assert json.loads(run("diff", a, b, "--json")[1])["platform"].startswith(told)
    elsewhere = write(tmp_path / "same.mcap", sent, header=header)
    assert run("diff", a, elsewhere) == (0, "same: 15 messages\n")
    another = msgspec.structs.replace(header, scenario='{"title": "Another"}')
    assert "recorded with" not in run("diff", a, write(tmp_path / "c.mcap", other, header=another))[1]


@pytest.mark.parametrize("command", ["info", "recover", "diff"])
def test_files_that_are_no_recording_are_told_in_one_line(run: Run, tmp_path: Path, command: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"")
    with pytest.raises(DynpfError, match=r"x\.mcap: the file is empty") as refused:
        run(command, path, *([path] if command == "diff" else []))
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code == 2
