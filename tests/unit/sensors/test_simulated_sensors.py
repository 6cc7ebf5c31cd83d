"""Simulated sensors: noise against its parameters, geometry in closed form, and a state that comes and goes."""

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest
from dynpf_protocol.errors import ScenarioError
from dynpf_protocol.landmarks import Landmark
from dynpf_protocol.messages import (
    LandmarkReadings,
    LaserScan,
    LineReadings,
    Message,
    Odometry,
    PositionFix,
    RobotState,
    Scanner,
)
from dynpf_runtime.node import Received, Step, decode_state, encode_state
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.schema import Scenario
from dynpf_services.sensors.simulated import KIND, SimulatedSensors, SimulatedSensorsConfig
from dynpf_systems.parts.messages import Detections, Gripper, PartsState, PartState
from dynpf_systems.parts.sensors import GripperSensor, OverheadSensor
from dynpf_systems.parts.task import PartSpec, RearrangementTask
from dynpf_systems.rooms.maps import NO_MAPS, Maps
from dynpf_systems.rooms.messages import Barrier, Disc, Obstacles
from dynpf_systems.rooms.sensors.landmarks import LandmarkSensor
from dynpf_systems.rooms.sensors.lines import LineSensor
from dynpf_systems.rooms.sensors.odometry import GyroSensor, OdometrySensor
from dynpf_systems.rooms.sensors.position import PositionSensor
from dynpf_systems.rooms.sensors.scan import ScanSensor

from dynpf.maps.segments import SegmentMap

TICK_NS = 50_000_000
TASK = RearrangementTask(parts=(PartSpec(radius=0.06, goal=(0.5, 0.5)), PartSpec(radius=0.11, goal=(-0.5, 0.5))))
LANDMARKS = (Landmark(id=6, x=3.0, y=0.0), Landmark(id=7, x=0.0, y=2.0), Landmark(id=9, x=-4.0, y=0.0))


def parts(*places: tuple[float, float, float], held: int = -1) -> PartsState:
    states = tuple(PartState(x=x, y=y, radius=radius, goal_x=0.0, goal_y=0.0) for x, y, radius in places)
    return PartsState(parts=states, held=held, contacts=0, finished=False)


def robot(x: float = 0.0, y: float = 0.0, theta: float = 0.0, v: float = 0.0, w: float = 0.0) -> RobotState:
    return RobotState(x=x, y=y, theta=theta, v=v, w=w)


def step(tick: int, *messages: Message) -> Step:
    topics = {RobotState: "truth/robot", PartsState: "truth/parts"}
    inputs = tuple(Received(topics[type(m)], "simulator", "b", tick, tick * TICK_NS, m) for m in messages)
    return Step(tick, tick, tick * TICK_NS, inputs)


def sensors(config: Any, seed: int = 1) -> SimulatedSensors:
    return SimulatedSensors(config, run_with(seed=seed, task=TASK, landmarks=LANDMARKS))


def run_with(maps: Maps = NO_MAPS, seed: int = 1, **facts: object) -> Context:
    """Return a run with some shared tables, and with these maps whatever the tables say."""
    return Context(Scenario(title="A run", seed=seed, tick_s=0.05, facts=facts), "sensors", {"maps": maps})


def outputs(node: SimulatedSensors, ticks: Iterable[int], *messages: Message) -> list[Message]:
    """Return what the node reads; what it says of its scanner before is left out."""
    said = [output.message for tick in ticks for output in node.step(step(tick, *messages)).outputs]
    return [message for message in said if not isinstance(message, Scanner)]


def assert_normal(samples: np.ndarray, mean: float, std: float) -> None:
    """Five standard errors: a right generator fails once in a million, a std 10 % off at n = 4000 always."""
    count = len(samples)
    assert abs(samples.mean() - mean) < 5 * std / math.sqrt(count)
    assert abs(samples.std() / std - 1) < 5 / math.sqrt(2 * count)


def test_odometry_noise_has_the_configured_bias_and_deviation() -> None:
    sensor = OdometrySensor(v_std=0.03, v_std_per_unit=0.1, v_bias=0.02, w_std=0.05, w_bias=-0.01)
    node = sensors(SimulatedSensorsConfig(odometry=sensor))
    readings = [m for m in outputs(node, range(4000), robot(v=0.4, w=0.7)) if isinstance(m, Odometry)]
    assert_normal(np.array([r.v for r in readings]), 0.42, 0.05)
    assert_normal(np.array([r.w for r in readings]), 0.69, 0.05)


def test_landmark_noise_grows_with_range() -> None:
    sensor = LandmarkSensor(range_std=0.03, range_std_per_metre=0.02, bearing_std=0.05)
    node = sensors(SimulatedSensorsConfig(landmarks=sensor))
    messages = [m for m in outputs(node, range(4000), robot()) if isinstance(m, LandmarkReadings)]
    for index, distance, bearing in ((0, 3.0, 0.0), (1, 2.0, math.pi / 2)):
        assert_normal(
            np.array([m.readings[index].range for m in messages]), distance, math.hypot(0.03, 0.02 * distance)
        )
        assert_normal(np.array([m.readings[index].bearing for m in messages]), bearing, 0.05)


def test_landmarks_out_of_range_or_view_give_no_reading() -> None:
    exact = partial(LandmarkSensor, range_std=0.0, bearing_std=0.0)
    node = sensors(SimulatedSensorsConfig(landmarks=exact(max_range=3.5)))
    (message,) = outputs(node, [0], robot())
    assert isinstance(message, LandmarkReadings)
    assert [(r.landmark, r.range, r.bearing) for r in message.readings] == [(6, 3.0, 0.0), (7, 2.0, math.pi / 2)]
    node = sensors(SimulatedSensorsConfig(landmarks=exact(field_of_view=math.pi / 3)))
    (message,) = outputs(node, [0], robot(theta=math.pi))
    assert isinstance(message, LandmarkReadings)
    assert [(r.landmark, r.range) for r in message.readings] == [(9, 4.0)]


def test_misread_landmarks_carry_another_known_number_at_the_configured_rate() -> None:
    sensor = LandmarkSensor(range_std=0.0, misread_probability=0.2)
    node = sensors(SimulatedSensorsConfig(landmarks=sensor))
    messages = [m for m in outputs(node, range(2000), robot()) if isinstance(m, LandmarkReadings)]
    seen = [message.readings[0].landmark for message in messages]  # of landmark 6
    wrong = sum(number != 6 for number in seen)
    assert abs(wrong - 400) < 5 * math.sqrt(2000 * 0.2 * 0.8)
    assert set(seen) == {6, 7, 9}


def test_a_sensor_reads_every_nth_true_state() -> None:
    config = SimulatedSensorsConfig(odometry=OdometrySensor(), landmarks=LandmarkSensor(every=3))
    node = sensors(config)
    kinds = [[output.topic for output in node.step(step(tick, robot())).outputs] for tick in range(4)]
    both = ["sensors/odometry", "sensors/landmarks"]
    assert kinds == [both, both[:1], both[:1], both]


@pytest.mark.parametrize(
    ("gap", "held", "closed"), [(0.0, -1, True), (0.0119, -1, True), (0.0121, -1, False), (0.5, 0, True)]
)
def test_the_contact_switch_closes_on_a_part_within_reach_or_held(gap: float, held: int, closed: bool) -> None:
    node = sensors(SimulatedSensorsConfig(gripper=GripperSensor(tolerance=0.002)))
    (reading,) = outputs(node, [0], robot(theta=3.5), parts((0.0, 0.1 + 0.06 + gap, 0.06), held=held))
    assert reading == Gripper(contact=closed, theta=pytest.approx(3.5 - math.tau))  # type: ignore[arg-type]


def test_a_scan_without_noise_is_the_geometry() -> None:
    scan = ScanSensor(beams=5, field_of_view=math.pi, range_max=0.9, range_std=0.0)
    node = sensors(SimulatedSensorsConfig(scan=scan))
    (message,) = outputs(node, [0], robot(x=0.4, theta=math.pi / 2), parts((0.4, 0.5, 0.1)))
    assert isinstance(message, LaserScan)
    assert (message.start_angle, message.end_angle) == (-math.pi / 2, math.pi / 2)
    # right wall, right wall obliquely, part, nothing within 0.9 m (upper wall at 1.41), nothing (left wall at 1.4)
    assert message.ranges == pytest.approx((0.6, 0.6 * math.sqrt(2), 0.4, 0.9, 0.9), abs=1e-12)


def test_scan_noise_touches_returns_alone() -> None:
    scan = ScanSensor(beams=2, field_of_view=math.pi, range_max=1.2, range_std=0.02)
    node = sensors(SimulatedSensorsConfig(scan=scan))
    ranges = np.array(
        [m.ranges for m in outputs(node, range(4000), robot(x=-0.5, theta=-math.pi / 2)) if isinstance(m, LaserScan)]
    )
    assert_normal(ranges[:, 0], 0.5, 0.02)
    assert np.all(ranges[:, 1] == 1.2)


def test_overhead_detections_have_the_configured_variance_misses_and_clutter() -> None:
    sensor = OverheadSensor(variance=4e-4, miss_probability=0.1, clutter_rate=0.5)
    node = sensors(SimulatedSensorsConfig(overhead=sensor))
    frames = [
        m for m in outputs(node, range(4000), robot(x=0.3), parts((-0.8, 0.8, 0.06))) if isinstance(m, Detections)
    ]
    near = [d for m in frames for d in m.discs if d.grey < 0 and math.hypot(d.x - 0.3, d.y) < 0.11]
    count = sum(len(m.discs) for m in frames)
    # 2 discs seen at 0.9 and 0.5 false ones a frame: mean 2.3, variance 2 * 0.09 + 0.5
    assert abs(count - 2.3 * 4000) < 5 * math.sqrt(4000 * 0.68)
    # At 5.5 sigma no detection is cut off, and of the clutter (0.25 dark discs a frame on 4 m^2) some 9 come in:
    # few enough for their share of the variance, 9 * 0.11^2 / 4 / 3600, to stay below two standard errors.
    assert abs(np.var([d.y for d in near]) / 4e-4 - 1) < 7 * math.sqrt(2 / len(near))
    assert {d.radius for d in near} == {0.1}


def test_detections_come_in_no_telling_order() -> None:
    node = sensors(SimulatedSensorsConfig(overhead=OverheadSensor()))
    frames = [m for m in outputs(node, range(200), robot(), parts((0.5, 0.5, 0.06))) if isinstance(m, Detections)]
    first = sum(m.discs[0].grey < 0 for m in frames)
    assert abs(first - 100) < 5 * math.sqrt(50)


def test_absent_sensors_are_off_and_undeclared() -> None:
    config = SimulatedSensorsConfig(odometry=OdometrySensor())
    node = sensors(config)
    assert {*KIND.writes(config, Context(load_scenario("room-scan"), "sensors"))} == {"sensors/odometry"}
    assert [type(m) for m in outputs(node, [0], robot(), parts((0.5, 0.5, 0.06)))] == [Odometry]


def test_old_missing_and_repeated_truth_never_crash_or_speak() -> None:
    config = SimulatedSensorsConfig(odometry=OdometrySensor(), overhead=OverheadSensor(), gripper=GripperSensor())
    node = sensors(config)
    assert node.step(step(0)).outputs == ()
    assert node.step(step(1, parts((0.5, 0.5, 0.06)))).outputs == ()
    assert len(node.step(step(5, robot(), robot(x=1.0))).outputs) == 3
    assert node.step(step(3, robot())).outputs == ()  # older than what was read


def test_a_hidden_part_is_not_detected_and_the_others_are_as_without_it() -> None:
    config = SimulatedSensorsConfig(overhead=OverheadSensor(variance=1e-6))
    seen = parts((0.4, 0.0, 0.06), (-0.4, 0.0, 0.11))
    found = []
    for state in (seen, msgspec.structs.replace(seen, hidden=(1,))):
        (output,) = sensors(config).step(step(0, robot(), state)).outputs
        assert isinstance(output.message, Detections)
        found.append({(disc.x, disc.y) for disc in output.message.discs})
    assert len(found[1]) == 2
    assert found[1] < found[0]


def test_robot_alone_gives_no_overhead_reading_before_the_parts_are_known() -> None:
    node = sensors(SimulatedSensorsConfig(odometry=OdometrySensor(), overhead=OverheadSensor()))
    assert [type(m) for m in outputs(node, [0], robot())] == [Odometry]


@pytest.mark.parametrize("sensor", ["gripper", "overhead", "scan", "landmarks"])
def test_a_sensor_without_its_facts_is_refused_by_name(sensor: str) -> None:
    kinds = {"gripper": GripperSensor, "overhead": OverheadSensor, "scan": ScanSensor, "landmarks": LandmarkSensor}
    with pytest.raises(ScenarioError, match=sensor):
        SimulatedSensors(SimulatedSensorsConfig(**{sensor: kinds[sensor]()}), run_with())


def test_a_thawed_node_continues_exactly_and_another_seed_does_not() -> None:
    config = SimulatedSensorsConfig(
        odometry=OdometrySensor(v_std=0.1, every=2),
        gripper=GripperSensor(theta_std=0.1),
        landmarks=LandmarkSensor(every=3),
        scan=ScanSensor(),
        overhead=OverheadSensor(clutter_rate=1.0),
    )
    first = sensors(config)
    world = (robot(v=0.2), parts((0.5, 0.5, 0.06)))
    outputs(first, range(4), *world)
    second, other = sensors(config), sensors(config, seed=2)
    state = decode_state(encode_state(first.freeze()))
    second.thaw(state)
    other.thaw(state)
    expected = outputs(first, range(4, 10), robot(x=0.1, v=0.3))  # the parts are remembered
    assert len(expected) == 6 * 3 + 3 + 2
    assert outputs(second, range(4, 10), robot(x=0.1, v=0.3)) == expected
    assert outputs(other, range(4, 10), robot(x=0.1, v=0.3)) != expected
    assert encode_state(second.freeze()) == encode_state(first.freeze())


def test_a_scanner_says_what_it_measures_between_once_before_its_first_scan() -> None:
    config = SimulatedSensorsConfig(odometry=OdometrySensor(), scan=ScanSensor(range_min=0.2, range_max=3.0, every=2))
    node = sensors(config)
    topics = [[output.topic for output in node.step(step(tick, robot())).outputs] for tick in range(3)]
    assert topics == [
        ["sensors/odometry", "sensors/scanner", "sensors/scan"],
        ["sensors/odometry"],
        ["sensors/odometry", "sensors/scan"],
    ]
    first = sensors(config).step(step(0, robot())).outputs[1].message
    assert first == Scanner(range_min=0.2, range_max=3.0)
    thawed = sensors(config)
    thawed.thaw(decode_state(encode_state(node.freeze())))
    assert [output.topic for output in thawed.step(step(4, robot())).outputs] == topics[1]
    assert [output.topic for output in thawed.step(step(5, robot())).outputs] == topics[2]


# --- in a map ------------------------------------------------------------------------------------------------------

SQUARE = SegmentMap([(-2, -2, 2, -2), (2, -2, 2, 2), (2, 2, -2, 2), (-2, 2, -2, -2), (1, -0.5, 1, 0.5)])


def in_map(config: Any, maps: Maps) -> SimulatedSensors:
    return SimulatedSensors(config, run_with(maps))


def test_lines_are_the_parts_of_walls_that_nothing_hides() -> None:
    sensor = LineSensor(beams=721, field_of_view=math.pi, max_range=3.0, rho_std=0.0, alpha_std=0.0)
    (message,) = outputs(in_map(SimulatedSensorsConfig(lines=sensor), Maps(segments=SQUARE)), [0], robot(theta=0.0))
    assert isinstance(message, LineReadings)
    lines = sorted(((round(line.alpha, 6), line) for line in message.readings), key=lambda one: one[0])
    # The lower wall, the wall behind the screen to its right and to its left, the screen itself, and the upper wall:
    # each ends where the screen or the range cuts it off.
    assert [angle for angle, _ in lines] == pytest.approx([-math.pi / 2, 0, 0, 0, math.pi / 2])
    assert sorted(line.rho for _, line in lines) == pytest.approx([1, 2, 2, 2, 2])
    (screen,) = (line for _, line in lines if line.rho < 1.5)
    assert screen.length == pytest.approx(1.0, abs=0.02)
    behind = [line.length for angle, line in lines if angle == 0.0 and line.rho > 1.5]
    assert behind == pytest.approx([1.0, 1.0], abs=0.04)  # from 1 m, in the screen's shadow, to the corner at 2 m


def test_line_noise_is_the_configured_one_and_a_distance_never_negative() -> None:
    sensor = LineSensor(beams=31, field_of_view=0.5, rho_std=0.05, alpha_std=0.02, min_length=0.1)
    node = in_map(SimulatedSensorsConfig(lines=sensor), Maps(segments=SQUARE))
    seen = [m.readings for m in outputs(node, range(4000), robot(theta=math.pi / 2)) if isinstance(m, LineReadings)]
    assert {len(lines) for lines in seen} == {1}
    assert_normal(np.array([line.rho for (line,) in seen]), 2.0, 0.05)
    assert_normal(np.array([line.alpha for (line,) in seen]), 0.0, 0.02)
    near = outputs(node, range(4000, 4100), robot(y=1.99, theta=math.pi / 2))
    readings = [line for m in near if isinstance(m, LineReadings) for line in m.readings]
    assert readings == []  # too near to see enough of it

    wide = LineSensor(beams=31, field_of_view=3.0, rho_std=0.05, alpha_std=0.0, max_range=10.0)
    node = in_map(SimulatedSensorsConfig(lines=wide), Maps(segments=SegmentMap([(-2, 2, 2, 2)])))
    near = outputs(node, range(100), robot(y=1.99, theta=math.pi / 2))
    readings = [line for m in near if isinstance(m, LineReadings) for line in m.readings]
    assert min(line.rho for line in readings) >= 0.0
    assert {round(abs(line.alpha), 6) for line in readings} == {0.0, round(math.pi, 6)}


def test_position_fixes_have_the_configured_deviation() -> None:
    node = in_map(SimulatedSensorsConfig(position=PositionSensor(std=0.3)), NO_MAPS)
    fixes = [m for m in outputs(node, range(4000), robot(x=1.0, y=-2.0)) if isinstance(m, PositionFix)]
    assert_normal(np.array([fix.x for fix in fixes]), 1.0, 0.3)
    assert_normal(np.array([fix.y for fix in fixes]), -2.0, 0.3)


def test_a_scan_in_a_map_meets_its_segments_or_its_cells() -> None:
    scan = ScanSensor(beams=5, field_of_view=math.pi, range_max=5.0, range_std=0.0)
    config = SimulatedSensorsConfig(scan=scan)
    by_segments = in_map(config, Maps(segments=SQUARE, grid=SQUARE.rasterize(0.5)))
    by_cells = in_map(config, Maps(grid=SQUARE.rasterize(0.01)))
    (exact,) = outputs(by_segments, [0], robot())
    (cells,) = outputs(by_cells, [0], robot())
    assert isinstance(exact, LaserScan)
    assert isinstance(cells, LaserScan)
    assert exact.ranges == pytest.approx((2.0, 2 * math.sqrt(2), 1.0, 2 * math.sqrt(2), 2.0))
    assert cells.ranges == pytest.approx(exact.ranges, abs=0.02)


def test_lines_need_a_map_of_segments() -> None:
    with pytest.raises(ScenarioError, match=r"sensors.lines needs a map of segments; this run has none"):
        in_map(SimulatedSensorsConfig(lines=LineSensor()), Maps(grid=SQUARE.rasterize(0.1)))


HALL = SegmentMap([(4, -3, 4, 3), (-4, -3, -4, 3), (-4, 3, 4, 3), (-4, -3, 4, -3)])


def in_hall(sensor: ScanSensor, *messages: Message) -> list[float]:
    """Return the ranges ahead, to the left and behind, from the middle of the hall."""
    node = in_map(SimulatedSensorsConfig(scan=sensor), Maps(segments=HALL))
    topics = {RobotState: "truth/robot", Obstacles: "truth/obstacles"}
    inputs = tuple(Received(topics[type(m)], "simulator", "b", 0, 0, m) for m in (robot(), *messages))
    _, output = node.step(Step(0, 0, 0, inputs)).outputs
    assert isinstance(output.message, LaserScan)
    ranges = output.message.ranges
    return [ranges[len(ranges) // 2], ranges[3 * len(ranges) // 4], ranges[0]]


EXACT = ScanSensor(beams=361, field_of_view=2 * math.pi, range_max=8.0, range_std=0.0)


def test_people_and_closed_doors_stop_beams() -> None:
    obstacles = Obstacles(people=(Disc(x=2.0, y=0.0, radius=0.25),), doors=(Barrier(x1=-1.0, y1=2.0, x2=1.0, y2=2.0),))
    assert in_hall(EXACT) == pytest.approx([4.0, 3.0, 4.0], abs=1e-6)
    assert in_hall(EXACT, obstacles) == pytest.approx([1.75, 2.0, 4.0], abs=1e-6)


def test_glass_gives_nothing_and_a_thing_too_near_gives_zero() -> None:
    glass = msgspec.structs.replace(EXACT, glass=((4.0, -3.0, 4.0, 3.0),))
    assert in_hall(glass) == pytest.approx([8.0, 3.0, 4.0], abs=1e-6)
    blind = msgspec.structs.replace(EXACT, range_min=3.5)
    assert in_hall(blind) == pytest.approx([4.0, 0.0, 4.0], abs=1e-6)
    with pytest.raises(ScenarioError, match=r"glass\.0: .* is no segment"):
        in_hall(msgspec.structs.replace(EXACT, glass=((4.0, -3.0, 4.0, 2.0),)))


def test_the_noise_of_a_depth_camera_grows_with_the_square_of_the_range() -> None:
    sensor = ScanSensor(beams=2, field_of_view=0.1, range_max=8.0, range_std=0.01, range_std_per_square_metre=0.005)
    node = in_map(SimulatedSensorsConfig(scan=sensor), Maps(segments=HALL))
    ranges = [m.ranges[0] for m in outputs(node, range(4000), robot()) if isinstance(m, LaserScan)]
    true = 4.0 / math.cos(0.05)
    assert_normal(np.array(ranges), true, 0.01 + 0.005 * true**2)


def test_a_gyro_corrects_the_turning_rate_of_wheels_and_is_part_of_the_state() -> None:
    sensor = OdometrySensor(w_std=0.01, w_scale=1.1, gyro=GyroSensor(w_std=0.002, w_bias=0.03))
    node, other = (sensors(SimulatedSensorsConfig(odometry=sensor)) for _ in range(2))
    for tick in range(600):
        said = node.step(step(tick, robot(w=0.5 if tick % 200 > 100 else 0.0))).outputs[0].message
    assert isinstance(said, Odometry)
    assert said.w == pytest.approx(0.5, abs=0.015)
    other.thaw(decode_state(encode_state(node.freeze())))
    assert other.step(step(600, robot(w=0.2))) == node.step(step(600, robot(w=0.2)))
