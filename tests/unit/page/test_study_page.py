"""The page of a study: every row with its interval, nothing of it markup, and figures inside."""

import re
from pathlib import Path

import pytest
from dynpf_lab.cli.main import main
from dynpf_lab.page.study import Told, study_page

TOLD = Told("a <b>study</b>", "What <script> asks", "dynpf study a", {"n": [50, 200]}, 4, 1)
ROWS = [
    {"n": 50, "start": "known", "trials": 4, "error_m_mean": 2.0, "error_m_ci_low": 1.0, "error_m_ci_high": 3.0},
    {"n": 200, "start": "known", "trials": 4, "error_m_mean": 1.5, "error_m_ci_low": 1.5, "error_m_ci_high": 1.5},
]
ROWS[0] |= {"lost": 25.0, "lost_ci_low": 5.0, "lost_ci_high": 60.0}


def test_rows_are_told_in_a_table_and_drawn_with_their_intervals() -> None:
    page = study_page(TOLD, ROWS, [])
    assert "<td>2 (1 to 3)</td>" in page
    assert "<td>25 (5 to 60)</td>" in page
    dots = [float(place) for place in re.findall(r'<circle cx="([\d.]+)"', page)]
    # On an axis from 1 to 3 of 420 px: in the middle, and a quarter on; the share of lost runs has an axis of its own.
    assert dots == [300.0 + 210.0, 300.0 + 105.0, pytest.approx(300.0 + 420.0 * 20.0 / 55.0, abs=0.05)]
    assert "n 50</text>" in page
    assert "start known</text>" not in page, "what all rows have alike tells none apart"


def test_no_text_is_markup_and_nothing_is_loaded(tmp_path: Path) -> None:
    figure = tmp_path / "rows.svg"
    figure.write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    page = study_page(TOLD, ROWS, [figure, tmp_path / "left-out.pdf"])
    assert "<b>study" not in page
    assert "<script" not in page
    assert page.count("<img") == page.count("data:image/svg+xml;base64,") == 1
    assert not re.findall(r'(?:src|href)="(?!data:)', page)


def test_a_sweep_leaves_its_page_unless_it_is_told_not_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["sweep", "landmark-room", "--seeds", "1:2", "--set", "estimator.n=10,20", "--set", "max_ticks=3"]
    words += ["--measure", "position_rmse_m", "--jobs", "1"]
    for name, more in (("with", []), ("without", ["--no-page"])):
        assert main([*words, "-o", str(tmp_path / name), *more]) == 0
        told = capsys.readouterr().err
        assert (tmp_path / name / "index.html").is_file() == (not more) == (f"{name}/index.html" in told)
    page = (tmp_path / "with" / "index.html").read_text()
    assert "estimator.n 10</text>" in page
    assert "position rmse m" in page
