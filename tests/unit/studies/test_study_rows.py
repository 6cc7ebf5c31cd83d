"""Rows from samples, and what they look like."""

import csv
import io
import math

import numpy as np
import pytest
from dynpf_experiments.rows import Sample, as_csv, as_table, summarized
from scipy import stats


def samples(values: list[float], tube: str, lost: int = 0) -> list[Sample]:
    return [
        Sample({"case": "1", "tube": tube}, {"error_px": value, "lost_percent": i < lost})
        for i, value in enumerate(values)
    ]


def test_a_row_for_each_tube_and_one_for_all() -> None:
    rows = summarized(samples([1.0, 2.0], "folds") + samples([3.0, 6.0], "haustra"), "tube")
    assert [(row["tube"], row["trials"], row["error_px_mean"]) for row in rows] == [
        ("folds", 2, 1.5),
        ("haustra", 2, 4.5),
        ("all", 4, 3.0),
    ]


def test_measures_carry_mean_median_percentile_and_students_interval() -> None:
    values = np.random.default_rng(1).exponential(2.0, 30)
    row = summarized(samples(list(values), "folds"), "tube")[0]
    low, high = stats.t.interval(0.95, 29, values.mean(), stats.sem(values))
    assert row["error_px_mean"] == pytest.approx(values.mean())
    assert row["error_px_median"] == pytest.approx(np.median(values))
    assert row["error_px_p95"] == pytest.approx(np.quantile(values, 0.95))
    assert (row["error_px_ci_low"], row["error_px_ci_high"]) == pytest.approx((low, high))


def test_shares_of_trials_stand_bare_with_wilsons_interval() -> None:
    row = summarized(samples([0.0] * 40, "folds", lost=3), "tube")[0]
    expected = stats.binomtest(3, 40).proportion_ci(0.95, "wilson")
    assert row["lost_percent"] == pytest.approx(7.5)
    assert (row["lost_percent_ci_low"], row["lost_percent_ci_high"]) == pytest.approx(
        (100 * expected.low, 100 * expected.high)
    )
    assert "lost_percent_mean" not in row


def test_what_is_not_known_is_left_out() -> None:
    some = [Sample({"tube": "x"}, {"delay_steps": value, "false": math.nan}) for value in (math.nan, 2.0)]
    row = summarized(some, "tube")[0]
    assert row["delay_steps_mean"] == 2.0
    assert row["delay_steps_ci_low"] is None
    assert not any(key.startswith("false") for key in row)


def test_csv_has_a_column_for_every_key() -> None:
    text = as_csv([{"a": 1}, {"a": 2, "b": 0.5}])
    assert list(csv.DictReader(io.StringIO(text))) == [{"a": "1", "b": ""}, {"a": "2", "b": "0.5"}]


def test_a_table_lines_up_and_leaves_blank_what_a_row_has_not() -> None:
    columns = (("case", "", "case"), ("x / y", ".1f", "x y"), ("p", ".2f", "p"))
    text = as_table([{"case": "1", "x": 1.0, "y": None}, {"case": "22", "p": 0.5}], columns)
    assert text == "case  x / y    p\n1     1.0 / -\n22             0.50"
