"""Measures as tables: words, values, units, what they are judged by, and what has changed, in percent."""

from dynpf_experiments.measure_table import before_and_after, changes_of, table_of

ONE = {"position_rmse_m": 0.25, "heading_rmse_rad": 0.1, "nees_mean": 3.0, "nees_low": 2.5, "nees_high": 3.5}


def test_a_table_has_units_and_the_interval_of_an_honest_filter() -> None:
    assert table_of({**ONE, "lost_fraction": 0.5, "complete": True, "alignment": {"position_rmse_m": 1.0}}) == [
        "Position RMSE  0.25  m",
        "Heading RMSE   5.73  deg",
        "NEES mean         3       2.5 to 3.5 if honest",
        "Lost             50  %",
    ]


def test_each_of_several_estimators_has_a_column() -> None:
    several = {**ONE, "npl": 1.5, "estimators": {"estimator": ONE, "other": {"position_rmse_m": 2.0}}}
    told = table_of(several)
    assert told[0].split() == ["estimator", "other"]
    assert told[1].split() == ["Position", "RMSE", "0.25", "2", "m"]
    assert told[2].split() == ["Heading", "RMSE", "5.73", "-", "deg"]
    assert told[-1].split() == ["NPL", "1.5"]


def test_changes_are_in_percent_where_there_is_a_number_to_begin_with() -> None:
    before = {"position_rmse_m": 0.25, "gaps": 0, "outcome": "task done", "content_digest": "a"}
    after = {"position_rmse_m": 0.5, "gaps": 2, "outcome": "stopped", "content_digest": "b", "npl": 1.5}
    changes = changes_of(before, after)
    assert changes["position_rmse_m"] == {"before": 0.25, "after": 0.5, "change_percent": 100.0}
    assert [changes[name]["change_percent"] for name in ("gaps", "outcome", "npl")] == [None, None, None]
    lines = [line.split() for line in before_and_after(changes)]
    assert lines[0] == ["before", "after", "change"]
    assert lines[1] == ["Position", "RMSE", "0.25", "0.5", "m", "+100.0", "%"]
    assert ["gaps", "0", "2"] in lines
    assert ["NPL", "-", "1.5"] in lines
    assert not any("digest" in word for line in lines for word in line)


def test_those_of_several_estimators_are_told_one_by_one() -> None:
    before, after = ({"estimators": {"other": {"position_rmse_m": value}}} for value in (1.0, 0.5))
    told = before_and_after(changes_of(before, after))[1]
    assert " ".join(told.split()) == "other: Position RMSE 1 0.5 m -50.0 %"
