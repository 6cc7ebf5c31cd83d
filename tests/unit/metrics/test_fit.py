"""Whether readings fit estimates is told without a truth: a displaced estimate does not fit, and a true one does."""

from dynpf_experiments.measures import measure
from dynpf_experiments.messages import RunMessages, Timed
from dynpf_experiments.messages import recorded as messages_of
from dynpf_protocol.messages import Estimate, FilterHealth, HealthFigures
from dynpf_systems.rooms.fit import fit_of, tracking
from msgspec import UNSET
from msgspec.structs import replace

from tests.unit.page.runs import short_run

HEALTHS = (
    FilterHealth(status="tracking", reason="", figures=HealthFigures()),
    FilterHealth(status="uncertain", reason="", figures=HealthFigures()),
    UNSET,
)


def displaced(run: RunMessages, x: float) -> RunMessages:
    def read(name: str) -> list[Timed]:
        messages = run.topic(name)
        return [
            timed._replace(message=replace(timed.message, x=timed.message.x + x))
            if isinstance(timed.message, Estimate)
            else timed
            for timed in messages
        ]

    return RunMessages(lambda: run.scenario, run.with_files, read, run.topics)


def test_beams_end_near_walls_at_the_estimate_and_not_beside_it() -> None:
    recording = short_run("room-scan", 60)
    run = messages_of(recording)
    found = fit_of(run)
    assert found["near_walls_fraction"] > 0.95
    assert found["near_walls_by_chance_fraction"] < 0.3
    assert fit_of(displaced(run, 0.7))["near_walls_fraction"] < found["near_walls_fraction"] - 0.2
    assert {name: measure(recording)[name] for name in found} == found


def test_without_scans_or_a_map_only_the_evidence_is_told() -> None:
    assert fit_of(messages_of(short_run("landmark-room", 60))).keys() == {"log_likelihood"}


def test_an_estimator_is_on_its_track_where_it_says_so_and_says_how_it_is() -> None:
    run = messages_of(short_run("landmark-room", 60))
    assert tracking(run, "estimator").all()

    def read(name: str) -> list[Timed]:
        return [
            timed._replace(message=replace(message, health=HEALTHS[index % len(HEALTHS)]))
            if isinstance(message := timed.message, Estimate)
            else timed
            for index, timed in enumerate(run.topic(name))
        ]

    told = tracking(RunMessages(lambda: run.scenario, run.with_files, read, run.topics), "estimator")
    assert told.tolist() == [True, False, False] * 20
