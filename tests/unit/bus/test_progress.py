"""What is shown of long work: how much is done, and from two seconds on the time that is left."""

import sys

import pytest
from dynpf_runtime.progress import Progress, Share, time_left


@pytest.mark.parametrize(
    ("done", "spent_s", "told"),
    [
        (1, 1.9, ""),
        (0, 5.0, ""),
        (100, 5.0, ""),
        (25, 5.0, ", 15 s left"),
        (25, 100.0, ", 5 min left"),
        (25, 7200.0, ", 6.0 h left"),
    ],
)
def test_the_time_left_is_that_at_the_pace_so_far(done: int, spent_s: float, told: str) -> None:
    assert time_left(done, 100, spent_s) == told


def test_a_line_is_updated_a_few_times_a_second_and_erased(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    times = iter([0.0, 0.1, 0.4, 0.5, 4.0])
    with Share(8, "tasks", clock=lambda: next(times)) as share:
        for done in range(1, 5):
            share.show(done, ", none broken")
    lines = capsys.readouterr().err.split("\r\x1b[K")
    assert lines == ["", "2 of 8 tasks, none broken", "4 of 8 tasks, none broken, 4 s left", ""]


def test_a_run_that_nobody_watches_shows_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(100, clock=iter([0.0, 9.0]).__next__)
    progress.show(50, 400)
    progress.clear()
    assert capsys.readouterr() == ("", "")
