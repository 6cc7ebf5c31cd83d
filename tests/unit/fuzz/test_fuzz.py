"""A short run of the fuzzer, and controls: that it finds what raises, hangs, takes too much or answers wrongly."""

import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from dynpf_formats.recording.doctor import examine
from dynpf_protocol.errors import UsageError

from checks.fuzz.anatomy import Anatomy
from checks.fuzz.cases import Workshop, files_case
from checks.fuzz.edits import edited
from checks.fuzz.payloads import payload_case
from checks.fuzz.sources import Sources, sources
from checks.fuzz.subjects import difference
from checks.fuzz.trial import Limits, Verdict, tried

GENEROUS = Limits(seconds=60.0, hang_seconds=200.0)  # a test asserts no duration; the long form does


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return sources(tmp_path_factory.mktemp("sound"))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers that overflow: no traceback
def test_hostile_files_are_refused_or_read(sound: Sources, tmp_path: Path) -> None:
    workshop, verdicts = Workshop(sound, tmp_path), set()
    for number in range(40):
        for trial in files_case(number, 1, workshop):
            outcome = tried(trial.action, GENEROUS)
            verdicts.add(outcome.verdict)
            assert outcome.verdict is not Verdict.FAULT, f"file {number}, {trial.subject}: {outcome.text}"
    assert verdicts == {Verdict.ACCEPTED, Verdict.REFUSED}


def test_hostile_payloads_are_refused_or_decoded() -> None:
    verdicts = set()
    for number in range(2000):
        trial = payload_case(number, 1)
        outcome = tried(trial.action, GENEROUS)
        verdicts.add(outcome.verdict)
        assert outcome.verdict is not Verdict.FAULT, f"payload {number}, {trial.subject}: {outcome.text}"
    assert verdicts == {Verdict.ACCEPTED, Verdict.REFUSED}


def test_a_recording_taken_apart_and_put_together_is_sound(sound: Sources, tmp_path: Path) -> None:
    path = tmp_path / "again.mcap"
    for original in sound.recordings.values():
        path.write_bytes(Anatomy.of(original.read_bytes()).bytes())
        assert examine(path) == examine(original) == []


def test_a_case_is_made_by_its_number_alone(sound: Sources) -> None:
    anatomy = Anatomy.of(sound.recordings["log"].read_bytes())
    first, again, other = (edited(anatomy, Random(seed)) for seed in (3, 3, 4))
    assert first == again != other


def raising() -> None:
    raise KeyError("estimator/state")


def refusing() -> None:
    raise UsageError("no such topic")


def endless() -> None:
    while True:
        pass


@pytest.mark.parametrize(
    ("action", "limits", "expected"),
    [
        (raising, GENEROUS, "KeyError: 'estimator/state'"),
        (endless, GENEROUS._replace(hang_seconds=0.05), "still busy after 0.05 s"),
        (lambda: b"x" * 2**28, GENEROUS._replace(bytes=2**25), "took "),
        (lambda: sum(range(10**6)), GENEROUS._replace(seconds=0.0), "took "),
    ],
)
def test_what_raises_hangs_or_takes_too_much_is_a_fault(
    action: Callable[[], object], limits: Limits, expected: str
) -> None:
    outcome = tried(action, limits)
    assert outcome.verdict is Verdict.FAULT
    assert outcome.text.startswith(expected)


def test_a_refusal_is_no_fault() -> None:
    assert tried(refusing, GENEROUS)[:2] == (Verdict.REFUSED, "no such topic")


def test_a_wrong_answer_is_a_fault(sound: Sources, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "same.mcap"
    shutil.copy(sound.recordings["log"], path)
    assert tried(lambda: difference(sound.recordings["log"], path), GENEROUS).verdict is Verdict.ACCEPTED
    monkeypatch.setattr("checks.fuzz.subjects._digest", str)  # of the name: another for each file
    outcome = tried(lambda: difference(sound.recordings["log"], path), GENEROUS)
    assert outcome.text.startswith("WrongAnswerError: diff returns 0")
