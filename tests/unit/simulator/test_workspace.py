"""The rearrangement workspace: determinism, noise, gripping, contacts."""

import math

import cv2
import msgspec
import numpy as np
import pytest
from dynpf_protocol.messages import Command, CompressedImage
from dynpf_runtime.node import Received, Step, state_digest
from dynpf_systems.parts.camera_model import CameraParams
from dynpf_systems.parts.config import Hiding, Intervention, WorkspaceConfig
from dynpf_systems.parts.messages import PartsCommand
from dynpf_systems.parts.simulator import WorkspaceSimulator, draw_starts
from dynpf_systems.parts.task import PartSpec, RearrangementTask

from dynpf.rng import generator
from dynpf.vision import Board, DetectionParams, detect_discs

TICK_S = 0.05
QUIET = WorkspaceConfig(process_variance=0.0)
IDLE = Command()
OPEN, CLOSE = PartsCommand(mode="mate", target=0), PartsCommand(mode="move", target=0, grip=True)


def task(*starts, robot=(0.0, 0.0)):
    parts = tuple(PartSpec(radius=0.08, goal=(0.5, 0.5 * index), start=start) for index, start in enumerate(starts))
    return RearrangementTask(parts=parts, robot_start=robot)


def simulator(of, config=QUIET, seed=1):
    return WorkspaceSimulator(config=config, seed=seed, tick_s=TICK_S, task=of)


def drive(node, *commands):
    """Step through the first tick and then one tick for each command; return (robot, parts, finished) of each.

    A command is how the robot moves, or what its gripper does, or both; the other is to stand still, and to open.
    """
    seen = []
    for tick, command in enumerate(((), *commands)):
        given = {type(one): one for one in (IDLE, OPEN, *(command if isinstance(command, tuple) else (command,)))}
        inputs = tuple(_received(one, tick) for one in given.values()) if command else ()
        result = node.step(Step(tick, tick, tick * 50_000_000, inputs))
        by_topic = {output.topic: output.message for output in result.outputs}
        seen.append((by_topic["truth/robot"], by_topic["truth/parts"], result.finished))
    return seen


def _received(command, tick):
    topic = "controller/parts" if isinstance(command, PartsCommand) else "controller/command"
    return Received(topic, "controller", "boot", tick, tick * 50_000_000, command)


def test_same_seed_same_bytes_and_another_seed_another_world():
    config = WorkspaceConfig()
    free = RearrangementTask(parts=(PartSpec(radius=0.06, goal=(0.0, 0.5)), PartSpec(radius=0.11, goal=(0.5, 0.0))))
    move = Command(vx=0.1, vy=-0.05, w=0.3)
    worlds = [simulator(free, config, seed) for seed in (5, 5, 6)]
    for world in worlds:
        drive(world, *[move] * 10)
    digests = [state_digest(world.freeze()) for world in worlds]
    assert digests[0] == digests[1]
    assert digests[0] != digests[2]


def test_a_thawed_world_continues_as_the_first():
    config = WorkspaceConfig()
    first, second = (simulator(task((0.4, 0.0)), config) for _ in range(2))
    move = Command(vx=0.2)
    drive(first, move, move)
    second.thaw(first.freeze())
    step = Step(3, 3, 150_000_000, (_received(move, 3),))
    assert first.step(step) == second.step(step)


def test_the_robot_goes_as_commanded_plus_noise_of_the_given_variance():
    config = WorkspaceConfig(process_variance=0.06e-4)
    world = simulator(task((0.9, 0.9)), config)
    back_and_forth = [Command(vx=0.2 * (-1) ** tick) for tick in range(3000)]
    path = np.array([(robot.x, robot.y) for robot, _, _ in drive(world, *back_and_forth)])
    commanded = np.array([(command.vx * TICK_S, 0.0) for command in back_and_forth])
    noise = np.diff(path, axis=0) - commanded
    # The standard error of a variance from n normal draws is variance sqrt(2 / n).
    np.testing.assert_allclose(noise.var(axis=0), 0.06e-4, rtol=5 * math.sqrt(2 / 3000))
    assert np.all(np.abs(noise.mean(axis=0)) < 5 * math.sqrt(0.06e-4 / 3000))


def test_a_part_moves_only_in_the_gripper():
    near = 0.1 + 0.08 + 0.015
    world = simulator(task((near, 0.0), (-0.5, -0.5)))
    push = Command(vy=0.1)
    grip = (Command(vx=-0.1, w=0.2), CLOSE)
    seen = drive(world, push, Command(vy=-0.1), grip, grip, push)
    where = [(parts.parts[0].x, parts.parts[0].y) for _, parts, _ in seen]
    assert [parts.held for _, parts, _ in seen] == [-1, -1, -1, 0, 0, -1]
    assert where[0] == where[1] == where[2] == (near, 0.0)
    for robot, parts, _ in seen[3:5]:
        offset = (parts.parts[0].x - robot.x, parts.parts[0].y - robot.y)
        assert math.hypot(*offset) == pytest.approx(0.1 + 0.08 + 0.01)
        assert math.atan2(offset[1], offset[0]) == pytest.approx(robot.theta)
    assert where[5] == where[4] != where[3]
    assert len({(parts.parts[1].x, parts.parts[1].y) for _, parts, _ in seen}) == 1


@pytest.mark.parametrize(("gap", "angle"), [(0.025, 0.0), (0.01, 0.25)])
def test_the_jaws_reach_only_so_far(gap, angle):
    centre = 0.18 + gap
    world = simulator(task((centre * math.cos(angle), centre * math.sin(angle))))
    assert drive(world, CLOSE)[-1][1].held == -1


def test_contacts_are_counted_by_tick_and_not_for_what_is_held():
    world = simulator(task((0.19, 0.0), (0.0, 0.185)))
    up = Command(vy=0.2)
    contacts = [parts.contacts for _, parts, _ in drive(world, CLOSE, CLOSE, up, up, IDLE)]
    assert contacts == [0, 0, 0, 1, 2, 3]


def test_a_wall_is_a_contact():
    world = simulator(task((0.5, 0.5), robot=(-0.895, 0.0)))
    assert drive(world, Command(vx=-0.2))[-1][1].contacts == 1


def test_the_run_ends_when_the_controller_has_finished():
    seen = drive(simulator(task((0.5, 0.5))), IDLE, Command(finished=True))
    assert [finished for _, _, finished in seen] == [False, False, True]
    assert seen[-1][1].finished


def test_drawn_starts_leave_room_for_the_robot():
    config = WorkspaceConfig()
    free = RearrangementTask(
        parts=tuple(PartSpec(radius=radius, goal=(0.0, 0.0)) for radius in (0.06, 0.1, 0.08, 0.11, 0.07, 0.09))
    )
    radii = np.array([0.06, 0.1, 0.08, 0.11, 0.07, 0.09, 0.1])
    for seed in range(10):
        robot, parts = draw_starts(free, config, generator(seed, "simulator", 0, "start"))
        centres = np.vstack([parts, robot])
        first, second = np.triu_indices(7, 1)
        gaps = np.linalg.norm(centres[first] - centres[second], axis=1) - radii[first] - radii[second]
        assert gaps.min() >= config.start_gap
        assert (1.0 - np.abs(centres) - radii[:, None]).min() >= config.start_wall_gap - 1e-12


def test_starts_that_do_not_fit_are_refused():
    crowded = RearrangementTask(parts=tuple(PartSpec(radius=0.2, goal=(0.0, 0.0)) for _ in range(20)))
    with pytest.raises(ValueError, match="ask for smaller gaps"):
        draw_starts(crowded, WorkspaceConfig(), generator(1, "simulator", 0, "start"))
    wide = RearrangementTask(parts=(PartSpec(radius=0.95, goal=(0.0, 0.0)),))
    with pytest.raises(ValueError, match="ask for smaller gaps"):
        draw_starts(wide, WorkspaceConfig(), generator(1, "simulator", 0, "start"))


def test_the_scene_is_drawn_five_times_a_second():
    world = simulator(task((0.5, 0.5)))
    drawn = [
        tick
        for tick in range(9)
        for output in world.step(Step(tick, tick, tick * 50_000_000, ())).outputs
        if output.topic == "truth/scene"
    ]
    assert drawn == [0, 4, 8]


def test_someone_puts_a_part_elsewhere_even_out_of_the_gripper():
    put = Intervention(tick=3, part=0, to=(-0.5, 0.5))
    world = simulator(task((0.19, 0.0)), msgspec.structs.replace(QUIET, interventions=(put,)))
    seen = [(parts.held, parts.parts[0].x) for _, parts, _ in drive(world, CLOSE, CLOSE, CLOSE, CLOSE)]
    assert [held for held, _ in seen] == [-1, 0, 0, -1, -1]
    assert [x for _, x in seen[3:]] == [-0.5, -0.5]


def test_a_hidden_part_is_told_and_not_drawn():
    given = task((0.4, 0.0), (-0.4, 0.0))
    hidden = msgspec.structs.replace(QUIET, hidings=(Hiding(tick=1, ticks=2, part=1),))
    seen = drive(simulator(given, hidden), *[IDLE] * 3)
    assert [parts.hidden for _, parts, _ in seen] == [(), (1,), (1,), ()]
    pictures = []
    for config in (hidden, QUIET):
        world = simulator(given, msgspec.structs.replace(config, camera=CameraParams()))
        outputs = [world.step(Step(tick, tick, tick * 50_000_000, ())).outputs for tick in range(2)]
        pictures.append([tick[-1].message.data for tick in outputs])
    (before, covered), (same, bare) = pictures
    assert before == same
    assert covered != bare


def test_what_slips_jumps_ahead_of_the_jaws_as_far_as_there_is_room():
    slippery = msgspec.structs.replace(QUIET, slip_probability=1.0)
    alone = drive(simulator(task((0.19, 0.0)), slippery), CLOSE)[-1][1]
    assert (alone.held, alone.parts[0].x, alone.contacts) == (-1, pytest.approx(0.22), 0)
    crowded = drive(simulator(task((0.19, 0.0), (0.36, 0.0)), slippery), CLOSE)[-1][1]
    assert (crowded.parts[0].x, crowded.contacts) == (pytest.approx(0.1975), 0)


def test_it_slips_as_often_as_the_scenario_says():
    config = msgspec.structs.replace(QUIET, slip_probability=0.3, slip_distance=0.0)
    world, held = simulator(task((0.19, 0.0)), config), 0
    for _, parts, _ in drive(world, *[CLOSE, IDLE] * 400)[1::2]:
        held += parts.held == 0
    assert held / 400 == pytest.approx(0.7, abs=4.0 * math.sqrt(0.3 * 0.7 / 400))


def test_a_disturbed_part_has_to_exist():
    config = msgspec.structs.replace(QUIET, hidings=(Hiding(tick=1, ticks=2, part=1),))
    with pytest.raises(ValueError, match="part 1 shall be moved or hidden; the task has parts 0 to 0"):
        simulator(task((0.4, 0.0)), config)


def test_the_board_lies_on_the_table_in_the_first_frame_alone():
    camera = CameraParams(board=Board())
    node = simulator(task((0.5, 0.3)), WorkspaceConfig(camera=camera))
    frames = []
    for tick in range(3):
        messages = [output.message for output in node.step(Step(tick, tick, tick * 50_000_000, ())).outputs]
        data = next(message.data for message in messages if isinstance(message, CompressedImage))
        frame = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_4)
        frames.append(np.asarray(frame, np.uint8))
    assert [len(detect_discs(frame, DetectionParams())) for frame in frames] == [49, 2, 2]
