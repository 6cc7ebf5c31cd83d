"""A trial of a study is the run of the same scenario and seed: with the sink on, it has the bytes of that run."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
from dynpf_experiments.catalogue import study_named, study_names
from dynpf_experiments.drive import drive, inputs_of, recorded_in
from dynpf_experiments.rows import Sample
from dynpf_experiments.study import Study, settings_from
from dynpf_formats.importers.carmen import import_carmen
from dynpf_formats.importers.mapping import drawn_map
from dynpf_formats.recording.digest import content_digest
from dynpf_formats.recording.reader import Recording, read_recording
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import log_records
from dynpf_services.scenario.record import LogContent, record_inline
from dynpf_services.scenario.recorded import recorded_scenario
from dynpf_systems.rooms.studies import kidnap
from dynpf_systems.rooms.studies.laser_logs import imported_log

DATA = Path(__file__).parents[3] / "../shared/data"
MINUTE, SLICE = DATA / "mrclam/ds1_seed_60s", DATA / "carmen/intel_30-150s.log"

SMALL = {
    "indoor": ["n=[60]", "n_deprived=60", "updates=20"],
    "landmark": [f"data=['{MINUTE}']", "experiments=['withheld']", "filters_n=30", "withheld=5", "seconds=4.0"],
    "turtlebot": ["worlds=['turtlebot-room']", "n=[60]", "updates=20", "loops=20", "n_panels=60"],
    "kidnap": ["logs=['slice']", "cases=['kidnapped']", "n=[300]", "updates=3", "lead=3", "kidnapped_m=2.0"],
    "parts-3": ["goals=['I']", "noises=['low']", "n=[0,20]", "ticks=200"],
    "parts-6": ["goals=['H']", "noises=['high']", "n=[20]", "ticks=200"],
    "parts-bounds": ["parts=[3]", "goals=['I']", "noises=['low']", "n=20", "ticks=60"],
    "parts-time": ["parts=3", "goals=E", "n=[20]"],
    "parts-vision": ["goals=['E']", "noises=['low']", "ticks=5", "frames=false"],
    "parts-alike": ["layouts=[0]", "noises=['low']", "cameras=[false]", "known=['starts']", "n=20", "ticks=60"],
    "parts-layouts": ["cases=['swap']", "noises=['high']", "n=20"],
}
"""Settings of the smallest trial."""
WITHOUT_NODES = {"colon-particles", "colon-cases", "colon-growth", "colon-hypotheses"}
"""Studies of COLON step filters on maps made once a process; test_colon_study holds their trials to runs."""


def first_trial(study: Study, settings: Any) -> list[Sample]:
    return study.run_task(study.tasks(settings, 1, 1)[0])


def again(recording: Recording, path: Path) -> Recording:
    """Run what a recording says that it is of, as ``dynpf run --runner inline`` does."""
    records = log_records(recording)
    log = LogContent(records, recording.attachments) if records else None
    scenario = recorded_scenario(recording)
    ticks = max(entry.tick for entry in recording.journal(*recording.journals()[0])) + 1
    record_inline(msgspec.structs.replace(scenario, max_ticks=ticks), path, log)
    return read_recording(path)


def without_times(samples: Sequence[Sample]) -> list[str]:
    return [
        repr((one.factors, {name: value for name, value in one.measures.items() if not name.endswith("_ms")}))
        for one in samples
    ]


def test_every_study_that_has_nodes_is_held_to_its_runs() -> None:
    assert {*SMALL} | WITHOUT_NODES == {*study_names()}


@pytest.mark.parametrize("name", SMALL)
def test_a_trial_recorded_is_the_run_of_its_scenario_and_seed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in {"landmark", "kidnap"} and not (MINUTE.is_dir() and SLICE.is_file()):
        pytest.skip(f"the logs are not at {DATA}")
    if name == "kidnap":
        drawn = drawn_map(lambda: import_carmen(SLICE).records, 0.05, "map")
        log = imported_log("slice", import_carmen(SLICE, attachments=drawn))
        monkeypatch.setattr(kidnap, "log_named", lambda _: log)
        monkeypatch.setattr(kidnap, "REST", 8)
    study = study_named(name)
    settings = settings_from(study.settings, SMALL[name])
    unrecorded = first_trial(study, settings)
    folder = tmp_path / "runs"
    folder.mkdir()
    with recorded_in(folder):
        recorded = first_trial(study, settings)
    assert without_times(recorded) == without_times(unrecorded)
    assert unrecorded
    recordings = sorted(folder.iterdir())
    assert recordings
    for path in recordings[:2]:
        recording = read_recording(path)
        assert recording.end is not None
        assert recording.end.complete
        assert content_digest(again(recording, tmp_path / path.name)) == content_digest(recording)


def test_only_a_node_that_nobody_waits_for_can_be_given_its_inputs_again() -> None:
    with pytest.raises(
        ValueError, match="controller reads estimator/identities, estimator/parts, estimator/state of estimator"
    ):
        inputs_of(load_scenario("parts-3-tracked"), "estimator", ())


def test_a_topic_that_was_not_observed_is_told() -> None:
    run = drive(load_scenario("landmark-room", overrides=["max_ticks=3"]), {"truth/robot"})
    assert len(run.topic("truth/robot")) == 3
    with pytest.raises(KeyError, match="estimator/state was not observed; observed are truth/robot"):
        run.topic("estimator/state")
