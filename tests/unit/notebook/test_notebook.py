"""Runs in Python: the bytes, figures and columns are those of the command line."""

import csv
import gc
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import read_recording
from dynpf_lab import Run, read, run
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import DynpfError, ScenarioError, UsageError
from dynpf_protocol.messages import Estimate
from dynpf_services.scenario.overrides import apply_override, overrides_of
from hypothesis import given
from hypothesis import strategies as st


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("runs") / "run.mcap"
    return run("landmark-room", seed=3, settings={"estimator.n": 50, "max_ticks": 30}, path=path)


def test_a_run_has_the_bytes_and_the_figures_of_the_command_line(
    made: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cli.mcap"
    words = [
        "landmark-room",
        "--no-page",
        "--seed",
        "3",
        "--set",
        "estimator.n=50",
        "--set",
        "max_ticks=30",
        "--runner",
        "inline",
    ]
    assert main(["run", *words, "-o", str(path), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert (figures["seed"], figures["clock"], figures["estimates"]) == (3, "lockstep", {"estimator/state": 30})
    assert figures["kinds"]["estimator"] == "localization"
    assert figures["settings"]["estimator"]["n"] == 50
    assert made.digest == content_digest(read_recording(path))
    assert made.metrics == {name: figures[name] for name in made.metrics}
    assert main(["metrics", str(made.path)]) == 0
    assert capsys.readouterr().out.startswith(f"{made}\n")
    assert read(path).difference(made) is None


def test_arrays_and_frames_have_the_columns_of_the_export(made: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(made.path), "--format", "csv", "--topic", "estimator/state"]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    states = made["estimator/state"]
    arrays, frame = states.arrays(), states.frame()
    assert len(rows) == len(states) == len(frame) == 30
    assert {"stamp_s", *frame.columns} == {*rows[0]}
    for name in ("stamp_s", "x", "n_eff", "health.figures.n_eff_share"):
        exported = np.array([float(row[name] or "nan") for row in rows])
        np.testing.assert_array_equal(arrays[name], exported)
        np.testing.assert_array_equal(frame.reset_index()[name].to_numpy(dtype=float), exported)
    np.testing.assert_array_equal(arrays["covariance"][:, 4], [float(row["covariance.4"]) for row in rows])
    assert arrays["covariance"].shape == (30, 9)
    assert arrays["health.status"].tolist() == [row["health.status"] for row in rows]
    assert made["truth/robot"].arrays()["heading_valid"].dtype == np.bool_


def test_messages_are_read_one_at_a_time(made: Run) -> None:
    stamp_s, message = next(iter(made["estimator/state"]))
    assert stamp_s == 0.0
    assert isinstance(message, Estimate)
    assert [message.x for _, message in made["estimator/state"]] == made.estimates().arrays()["x"].tolist()


def test_truth_particles_and_health_have_names_of_their_own(made: Run) -> None:
    assert made.truth.topic == "truth/robot"
    assert made.estimators == ("estimator",)
    clouds = list(made.particles())
    assert clouds[0].poses.shape == (3, 50)
    assert len(clouds) == len(made["estimator/particles"])
    pose = next(iter(made["estimator/particles"]))[1].poses[7].position
    assert clouds[0].poses[:2, 7].tolist() == [pose.x, pose.y]
    health = made.health()
    assert set(health["status"]) <= {"tracking", "uncertain", "lost", "kidnapped", "map_does_not_fit"}
    assert len(health["stamp_s"]) == len(health["figures.n_eff_share"]) == 30


def test_a_replay_repeats_every_byte_and_tells_where_settings_change_them(made: Run, tmp_path: Path) -> None:
    assert made.replay().digest == made.digest
    fewer = made.replay(node="estimator", settings={"estimator.n": 20}, path=tmp_path / "fewer.mcap")
    assert fewer.path == tmp_path / "fewer.mcap"
    first = made.difference(fewer)
    assert first is not None
    assert first.node == "estimator"
    assert next(fewer.particles()).poses.shape == (3, 20)
    shorter = made.replay(settings={"max_ticks": 10})
    assert len(shorter.estimates()) == 10


def test_a_temporary_recording_goes_with_its_run() -> None:
    states = run("landmark-room", settings={"max_ticks": 3})["estimator/state"]
    folder = states.run.path.parent
    gc.collect()
    assert len(states) == 3  # what is used keeps it
    if (child := os.fork()) == 0:  # a copy of this process that drops its copy of the run
        del states
        gc.collect()
        os._exit(0)
    os.waitpid(child, 0)
    assert folder.exists()
    del states
    gc.collect()
    assert not folder.exists()


def test_several_estimators_are_asked_for_by_name() -> None:
    filters = run("landmark-filters", settings={"max_ticks": 5})
    assert {*filters.estimators} == {*filters.metrics["estimators"]} == {"estimator", "extended", "unscented"}
    assert filters.estimates("extended").topic == "extended/state"
    with pytest.raises(UsageError, match="has several estimators; name one of "):
        filters.estimates()
    with pytest.raises(UsageError, match="has no estimator pf; name one of "):
        filters.health("pf")


@pytest.mark.parametrize(
    ("settings", "more", "error", "said"),
    [
        ({"estimator.m": 3}, {}, ScenarioError, "estimator.m"),
        ({"estimator.n": object()}, {}, ScenarioError, "estimator.n: .* is a object; expected a number"),
        ({}, {"path": __file__}, UsageError, "the file exists"),
        ({}, {"code": ["nowhere"]}, UsageError, "--code nowhere: no such folder"),
        ({"clock": "realtime"}, {}, UsageError, "a realtime run needs processes of its own"),
    ],
)
def test_what_does_not_fit_is_told(
    settings: dict[str, Any], more: dict[str, Any], error: type[DynpfError], said: str
) -> None:
    with pytest.raises(error, match=said):
        run("landmark-room", settings=settings, **more)


def test_a_topic_that_is_not_there_and_pandas_that_is_not_there_are_told(
    made: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match="nothing on sensors/scan; it has controller/command, "):
        made["sensors/scan"]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match=r"a data frame needs the package pandas: pip install 'dynpf-lab\[frames\]'"):
        made.truth.frame()


PLAIN = st.recursive(
    st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab. é", min_size=1), inner, max_size=3),
    max_leaves=6,
)


@given(PLAIN)
def test_settings_of_python_are_overrides_of_the_same_values(value: Any) -> None:
    raw: dict[str, Any] = {}
    (override,) = overrides_of({"a.b": value})
    apply_override(raw, override)
    assert raw == {"a": {"b": value}}
    assert type(raw["a"]["b"]) is type(value)
