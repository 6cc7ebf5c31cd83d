"""Scenarios: every error is told with the file, the key, the value, what was expected, and the nearest known name."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_runtime.machines.agreement import first_difference
from dynpf_services.scenario.build import build_nodes, plan_of
from dynpf_services.scenario.load import find_scenario, load_scenario, override_resolved, parse_scenario, scenario_files
from dynpf_services.scenario.schema import LogFacts, resolved_json, whole_json
from dynpf_systems.rooms.config import RoomConfig

from tests.unit.services.small_log import FACTS

Raw = dict[str, Any]
TOML = 'title = "A room"\n\n[simulator]\nkind = "room"\n\n[[landmarks]]\nid = 1\nx = 0.0\ny = 1.0\n'
KEYS = (
    "title, seed, clock, rate, tick_s, max_ticks, needs_log, log_digest, state_digest_ticks, files, user_code, faults, "
    "map, landmarks, task, colon, maps, simulator, vision, sensors, estimator, controller"
)


def room(**changes: Any) -> Raw:
    raw = {
        "title": "A room",
        "simulator": {"kind": "room"},
        "controller": {"kind": "waypoints", "points": [[1.0, 0.0]]},
        "landmarks": [{"id": 1, "x": 0.0, "y": 1.0}],
        **changes,
    }
    return {key: value for key, value in raw.items() if value is not None}


FAULT = {"topic": "controller/command", "to": "simulator"}
ERRORS: list[tuple[Raw, str]] = [
    (room(sede=3), "sede: unknown key; did you mean 'seed'?"),
    (room(qqq=3), f"qqq: unknown key; known: {KEYS}"),
    (room(simulator={"kind": "room", "widht": 3}), "simulator.widht: unknown key; did you mean 'width'?"),
    (room(simulator={"kind": "room", "max_ticks": 3}), "simulator.max_ticks: unknown key; did you mean 'max_speed'?"),
    (room(landmarks=[{"id": 1, "x": 0, "y": 1, "z": 2}]), "landmarks.0.z: unknown key; known: id, x, y"),
    (room(seed="x"), 'seed: "x": expected `int`, got `str`'),
    (room(seed=1.5), "seed: 1.5: expected `int`, got `float`"),
    (room(seed=-1), "seed: -1: expected `int` >= 0"),
    (room(max_ticks=0), "max_ticks: 0: expected `int` >= 1"),
    (room(simulator={"kind": "room", "width": 0.0}), "simulator.width: 0.0: expected `float` > 0.0"),
    (room(simulator={"kind": "room", "width": float("inf")}), "simulator.width: inf: expected a finite number"),
    (room(landmarks=[{"id": 1, "x": float("nan"), "y": 1}]), "landmarks.0.x: nan: expected a finite number"),
    (room(faults=[{**FAULT, "loss": 2}]), "faults.0.loss: 2: expected `float` <= 1.0"),
    (room(simulator=3), "simulator: 3; expected a table, such as [simulator]"),
    (room(landmarks=[{"id": "a", "x": 0, "y": 1}]), 'landmarks.0.id: "a": expected `int`, got `str`'),
    (room(title=None), "scenario: object missing required field `title`"),
    (room(clock="lock-step"), "clock: 'lock-step'; expected one of lockstep, realtime; did you mean 'lockstep'?"),
    (
        room(simulator={"kind": "rom"}),
        "simulator.kind: 'rom'; expected one of capsule, room, workspace, package.module:Name; did you mean 'room'?",
    ),
    (room(simulator={}), "simulator.kind: missing; expected one of capsule, room, workspace, package.module:Name"),
    (room(simulator=None), "a run needs a source: a [simulator], or [sensors] that play a log"),
    (room(sensors={"kind": "log"}), "sensors.kind: 'log' and needs_log = true go together"),
    (
        room(faults=[{**FAULT, "to": "simulater"}]),
        "faults.0.to: 'simulater' is not a node of this run; did you mean 'simulator'?",
    ),
    (room(faults=[FAULT, FAULT]), "faults.1: controller/command to simulator stands in faults.0 already"),
    (
        room(simulator={"kind": "workspace"}),
        "task: missing; the workspace simulator needs the parts and their goals",
    ),
]


@pytest.mark.parametrize(("raw", "told"), ERRORS, ids=[told[:40] for _, told in ERRORS])
def test_each_kind_of_error_in_its_words(raw: Raw, told: str) -> None:
    with pytest.raises(ScenarioError) as error:
        parse_scenario(raw, "run.toml")
    assert error.value.exit_code == 2
    assert "\n" not in str(error.value)
    assert str(error.value) == f"run.toml: {told}"


def test_all_problems_are_told_at_once() -> None:
    with pytest.raises(ScenarioError) as error:
        parse_scenario(room(sede=3, simulator={"kind": "room", "widht": 1}), "run.toml")
    assert str(error.value) == (
        "run.toml: simulator.widht: unknown key; did you mean 'width'?\n"
        "run.toml: sede: unknown key; did you mean 'seed'?"
    )
    with pytest.raises(ScenarioError) as error:
        parse_scenario(room(needs_log=True), "run.toml")
    assert str(error.value) == (
        "run.toml: simulator: a run that plays a log (needs_log) has no simulator\n"
        "run.toml: sensors.kind: 'log' and needs_log = true go together"
    )


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], str]:
    def call(name: str, text: str) -> str:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return call


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.toml", "title = \n", "Invalid value"),
        ("a.json", "{", "Expecting property name"),
        ("a.json", "[1]", "holds a list, expected a table of keys"),
    ],
)
def test_unreadable_files_are_told(write: Any, name: str, text: str, told: str) -> None:
    path = write(name, text)
    with pytest.raises(ScenarioError) as error:
        load_scenario(path)
    assert str(error.value).startswith(f"{path}: {told}")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("landmark-rom", "unknown scenario 'landmark-rom'; did you mean 'landmark-room'? (dynpf list shows them)"),
        ("no/such.toml", "scenario file no/such.toml: no such file"),
        ("such.json", "scenario file such.json: no such file"),
    ],
)
def test_scenarios_that_are_not_there_are_told(name: str, told: str) -> None:
    with pytest.raises(ScenarioError) as error:
        find_scenario(name)
    assert str(error.value) == told


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("seed=7", lambda one: one.seed == 7),
        ("tick_s=0.5", lambda one: one.tick_s == 0.5),
        ("title=Another one", lambda one: one.title == "Another one"),  # no TOML value: a text
        ('title="5"', lambda one: one.title == "5"),
        ("title=a=b", lambda one: one.title == "a=b"),
        ("clock=realtime", lambda one: one.clock == "realtime"),
        ("simulator.start=[1.0, 0.5, 0.0]", lambda one: one.simulator.start == (1.0, 0.5, 0.0)),
        ("landmarks.0.x=3", lambda one: one.landmarks[0].x == 3.0),
        ("controller={kind = 'waypoints', points = [[1, 2]]}", lambda one: one.controller.points == ((1.0, 2.0),)),
        ("estimator.kind=localization", lambda one: one.estimator.n == 1000),  # a table that was not there
    ],
)
def test_overrides(write: Any, override: str, value: Callable[[Any], bool]) -> None:
    path = write("run.toml", TOML)
    assert not value(
        parse_scenario(
            {
                **room(),
                "controller": {"kind": "waypoints", "points": [[0, 0]]},
                "estimator": {"kind": "localization", "n": 7},
            },
            "",
        )
    )
    assert value(load_scenario(path, overrides=[override]))


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("seed", "--set seed: expected key=value, such as estimator.n=500"),
        ("=3", "--set =3: expected key=value, such as estimator.n=500"),
        ("title.x=3", "--set title.x=3: title is 'A room', which has no keys"),
        ("title.x.y=3", "--set title.x.y=3: title.x lies inside 'A room', which has no keys"),
        ("landmarks.1.x=3", "--set landmarks.1.x=3: landmarks.1: expected an index from 0 to 0; got '1'"),
        (
            "landmarks.first=3",
            "--set landmarks.first=3: landmarks.first: expected an index from 0 to 0, or 1 to append; got 'first'",
        ),
        (
            "landmarks[0].x=3",
            "--set landmarks[0].x=3: an item of a list is named by its number after a dot: landmarks.0.x",
        ),
        (
            "estimator.kind=kalman",
            "PATH: estimator.kind: 'kalman'; expected one of capsule, localization, rearrangement, "
            "package.module:Name; localization has it as filter = 'extended_kalman'",
        ),
        ("seed=x", 'PATH: seed: "x": expected `int`, got `str`'),
        ("sede=1", "PATH: sede: unknown key; did you mean 'seed'?"),
    ],
)
def test_overrides_that_cannot_be(write: Any, override: str, told: str) -> None:
    path = write("run.toml", TOML)
    with pytest.raises(ScenarioError) as error:
        load_scenario(path, overrides=[override])
    assert str(error.value) == told.replace("PATH", path)


def test_later_words_win_and_options_win_over_overrides(write: Any) -> None:
    path = write("run.toml", TOML)
    assert load_scenario(path, overrides=["seed=2", "seed=3"]).seed == 3
    scenario = load_scenario(path, overrides=["seed=2", "clock=lockstep"], seed=9, clock="realtime")
    assert (scenario.seed, scenario.clock) == (9, "realtime")


@pytest.mark.parametrize("path", scenario_files(), ids=lambda path: path.stem)
def test_a_resolved_scenario_is_the_scenario(path: Path, write: Any) -> None:
    scenario = load_scenario(path.stem)
    resolved, whole = resolved_json(scenario), whole_json(scenario)
    assert override_resolved(whole, (), "") == scenario
    assert load_scenario(write("again.json", whole)) == scenario
    assert first_difference(resolved, resolved_json(override_resolved(resolved, (), ""))) is None
    if scenario.needs_log:
        scenario = load_scenario(path.stem, log=FACTS)
    nodes = build_nodes(scenario)
    assert nodes.keys() == scenario.nodes.keys()  # these are as declared, the graph's in the order of a tick
    assert tuple(nodes) == plan_of(scenario).graph.nodes


def test_the_first_key_that_differs_is_named_with_both_values() -> None:
    ours = parse_scenario(room(), "")

    def against(**changes: Any) -> Any:
        return first_difference(resolved_json(ours), resolved_json(parse_scenario(room(**changes), "")))

    assert against() is None
    assert against(seed=5) == ("seed", 1, 5)
    assert against(seed=5, clock="realtime") == ("clock", "lockstep", "realtime")
    assert against(simulator={"kind": "room", "width": 7.5}) == ("simulator.width", 6.0, 7.5)
    assert against(landmarks=[{"id": 1, "x": 0.5, "y": 1.0}]) == ("landmarks.0.x", 0.0, 0.5)
    assert against(landmarks=[*room()["landmarks"], {"id": 2, "x": 0, "y": 0}]) == ("landmarks.1.id", None, 2)
    assert against(estimator={"kind": "localization"}) == ("estimator.adaptation", None, [])


def playing_a_log(start: Raw) -> str:
    raw = {
        "title": "A log",
        "needs_log": True,
        "sensors": {"kind": "log"},
        "estimator": {"kind": "localization", "start": start},
    }
    return json.dumps(raw)


def test_a_log_brings_its_digest_its_landmarks_and_its_first_pose(write: Any) -> None:
    log = LogFacts("d1", [{"id": 4, "x": 1.0, "y": 2.0}], {"": (1.0, 2.0, 0.5)})
    scenario: Any = load_scenario(write("log.json", playing_a_log({"kind": "known"})), log=log)
    assert scenario.log_digest == "d1"
    assert [(one.id, one.x, one.y) for one in scenario.landmarks] == [(4, 1.0, 2.0)]
    start = scenario.estimator.start
    assert (start.x, start.y, start.theta) == (1.0, 2.0, 0.5)


def test_what_the_scenario_says_itself_stands_against_the_log(write: Any) -> None:
    log = LogFacts("d1", [{"id": 4, "x": 1.0, "y": 2.0}], {"": (1.0, 2.0, 0.5)})
    path = write("log.json", playing_a_log({"kind": "known", "x": 9.0}))
    scenario: Any = load_scenario(
        path, log=log, overrides=["landmarks=[{id = 8, x = 0, y = 0}]", "estimator.start.y=7"]
    )
    start = scenario.estimator.start
    assert (start.x, start.y, start.theta) == (9.0, 7, 0.5)
    assert [one.id for one in scenario.landmarks] == [8]


def test_a_room_has_no_limit_of_ticks_of_its_own() -> None:
    scenario = parse_scenario(room(max_ticks=4), "")
    assert isinstance(scenario.simulator, RoomConfig)
    assert scenario.max_ticks == 4
    assert scenario.tick_ns == 50_000_000


def test_a_fault_on_a_way_that_nothing_takes_is_refused() -> None:
    fault = 'faults=[{topic="truth/robot", to="estimator", loss=0.1}]'
    with pytest.raises(ScenarioError, match="estimator does not read truth/robot; it reads"):
        build_nodes(load_scenario("landmark-room", overrides=[fault]))
    # A topic is known by what the nodes of the run read, whatever it is called.
    with pytest.raises(ScenarioError) as error:
        plan_of(parse_scenario(room(faults=[{**FAULT, "topic": "controller/comand"}]), ""))
    told = "faults.0.topic: simulator does not read controller/comand; it reads controller/command"
    assert str(error.value) == told
    fault = 'faults=[{topic="sensors/odometry", to="estimator", loss=0.1}]'
    assert "estimator" in build_nodes(load_scenario("landmark-room", overrides=[fault]))
