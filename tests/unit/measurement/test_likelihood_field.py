"""The likelihood field against its definition, beam by beam and cell by cell."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf import kernels
from dynpf.maps.occupancy import OccupancyGrid
from dynpf.measurement.likelihood_field import BeamSkip, LikelihoodField, LikelihoodFieldParams
from dynpf.measurement.scan import Scan
from dynpf.reference import likelihood_field as reference
from dynpf.rng import Stream, generator

RANGE_MAX = 10.0


def room(yaw=0.0):
    """A room of 4 m x 3 m in cells of 10 cm with its lower left corner at (-1, 2), walls all round."""
    occupied = np.ones((30, 40), dtype=bool)
    occupied[1:-1, 1:-1] = False
    return OccupancyGrid.from_bools(occupied, 0.1, (-1.0, 2.0, yaw))


def scan(angles, ranges):
    return Scan(np.array(angles, dtype=np.float32), np.array(ranges, dtype=np.float32), 0.1, RANGE_MAX)


def pose(x, y, theta):
    return np.array([[x], [y], [theta]], dtype=np.float32)


def density(distance, params):
    peak = params.z_hit / (np.sqrt(2 * np.pi) * params.sigma_hit)
    return peak * np.exp(-0.5 * (distance / params.sigma_hit) ** 2) + params.z_rand / RANGE_MAX


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(0, 2**32), st.integers(1, 700), st.integers(1, 12), st.floats(-3.2, 3.2))
def test_the_kernel_agrees_with_its_reference(seed, count, beams, turn):
    draw = generator(seed, "test", 0)
    table = draw.uniform(-5.0, 0.0, (20, 30)).astype(np.float32)
    poses = draw.uniform(-3.0, 3.0, (3, count)).astype(np.float32)
    ends = draw.uniform(-12.0, 12.0, (2, beams)).astype(np.float32)
    frame = np.array([turn, 11.5, 9.5, 3.0], dtype=np.float32)
    total = np.empty(count, dtype=np.float32)
    kernels.likelihood_field.sum_over_beams(*poses, *ends, table, frame, total)
    expected = reference.sum_over_beams(
        poses.astype(float), ends.astype(float), table.astype(float), tuple(frame.astype(float))
    )
    # An end is rounded to float32 at up to 40 cells: about one in 10^5 falls into the neighbouring cell.
    differs = np.abs(total - expected) > 1e-5 * beams
    assert np.count_nonzero(differs) <= 1 + 2e-4 * count * beams


RANGES = st.floats(-1.0, 12.0, width=32) | st.sampled_from([np.nan, np.inf, -np.inf, 10.0, 0.3])


@settings(derandomize=True, deadline=None)
@given(st.lists(st.tuples(st.floats(-7.0, 7.0, width=32) | st.just(np.nan), RANGES), max_size=80), st.integers(1, 40))
def test_the_kernel_finds_the_ends_of_the_beams_that_a_scan_calls_usable(beams, max_beams):
    angles, ranges = np.array(beams, dtype=np.float32).reshape(-1, 2).T
    seen, mount = Scan(angles, ranges, 0.3, RANGE_MAX), (0.3, -0.2, 0.5)
    x, y = np.empty((2, max_beams), dtype=np.float32)
    count = kernels.likelihood_field.find_beam_ends(
        *seen.beams(), 0.3, RANGE_MAX, np.array(mount, dtype=np.float32), 20.0, x, y
    )
    expected = reference.beam_ends(seen, mount, 20.0, max_beams)
    assert count == expected.shape[1]
    # Angles of up to 7.5 rad and ends of up to 210 cells, each rounded to float32 a few times.
    np.testing.assert_allclose([x[:count], y[:count]], expected, atol=3e-4)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_a_beam_is_as_likely_as_its_end_is_close_to_a_wall(yaw):
    params = LikelihoodFieldParams(sigma_hit=0.2)
    field = LikelihoodField(params, room(yaw))
    # In the grid's frame the robot stands at (1.05, 1.55) and looks along its rows; the wall's cells begin at 3.9.
    corner = np.array([-1.0, 2.0])
    x, y = corner + np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]) @ [1.05, 1.55]
    for reading, cells_off in ((2.90, 0), (2.70, 2), (2.40, 5)):
        found = field.log_likelihood(pose(x, y, yaw), scan([0.0], [reading]))
        assert found[0] == pytest.approx(np.log(density(0.1 * cells_off, params)), rel=1e-5)


def test_the_beams_of_a_scan_multiply_and_temper():
    one, two = scan([0.0], [2.9]), scan([np.pi / 2], [1.0])
    both = scan([0.0, np.pi / 2], [2.9, 1.0])
    where = pose(0.05, 3.55, 0.0)
    field = LikelihoodField(LikelihoodFieldParams(), room())
    total = field.log_likelihood(where, one) + field.log_likelihood(where, two)
    np.testing.assert_allclose(field.log_likelihood(where, both), total, rtol=1e-6)
    tempered = LikelihoodField(LikelihoodFieldParams(tempering=0.25), room())
    np.testing.assert_allclose(tempered.log_likelihood(where, both), 0.25 * total, rtol=1e-6)
    cubes = LikelihoodField(LikelihoodFieldParams(aggregation="cubes"), room())
    expected = np.log1p(np.exp(3 * field.log_likelihood(where, one)) + np.exp(3 * field.log_likelihood(where, two)))
    np.testing.assert_allclose(cubes.log_likelihood(where, both), expected, rtol=1e-5)


def test_the_sensor_need_not_sit_at_the_robots_centre():
    params = LikelihoodFieldParams(sensor_x=0.3, sensor_y=-0.2, sensor_theta=0.5)
    seen = scan([0.1, -1.0], [2.0, 1.0])
    mounted = LikelihoodField(params, room()).log_likelihood(pose(0.5, 3.0, 1.1), seen)
    c, s = np.cos(1.1), np.sin(1.1)
    sensor = pose(0.5 + 0.3 * c + 0.2 * s, 3.0 + 0.3 * s - 0.2 * c, 1.6)
    central = LikelihoodField(LikelihoodFieldParams(), room()).log_likelihood(sensor, seen)
    np.testing.assert_allclose(mounted, central, rtol=1e-4)


def test_a_scan_that_tells_where_it_was_taken_is_taken_there_and_the_model_adds_to_it():
    field = LikelihoodField(LikelihoodFieldParams(sensor_x=0.3, sensor_y=-0.2, sensor_theta=0.5), room())
    seen = scan([0.1, -1.0], [2.0, 1.0])._replace(mount=(0.1, 0.4, -0.7))
    c, s = np.cos(-0.7), np.sin(-0.7)
    whole = LikelihoodFieldParams(sensor_x=0.1 + 0.3 * c + 0.2 * s, sensor_y=0.4 + 0.3 * s - 0.2 * c, sensor_theta=-0.2)
    expected = LikelihoodField(whole, room()).log_likelihood(pose(0.5, 3.0, 1.1), seen._replace(mount=(0.0, 0.0, 0.0)))
    np.testing.assert_allclose(field.log_likelihood(pose(0.5, 3.0, 1.1), seen), expected, rtol=1e-4)


def test_smoothing_widens_the_noise_by_the_pose_s_own():
    field, seen = LikelihoodField(LikelihoodFieldParams(sigma_hit=0.3), room()), scan([0.1], [1.7])
    wide = LikelihoodField(LikelihoodFieldParams(sigma_hit=0.5), room()).log_likelihood(pose(0.5, 3.0, 1.1), seen)
    before = field.log_likelihood(pose(0.5, 3.0, 1.1), seen)
    np.testing.assert_array_equal(field.smoothed(0.4).log_likelihood(pose(0.5, 3.0, 1.1), seen), wide)
    np.testing.assert_array_equal(field.log_likelihood(pose(0.5, 3.0, 1.1), seen), before)
    assert not np.array_equal(before, wide)


def test_what_tells_nothing_changes_nothing():
    field = LikelihoodField(LikelihoodFieldParams(), room())
    particles = np.concatenate([pose(0.5, 3.0, 0.1), pose(500.0, -3e6, 0.2)], axis=1)
    weights = np.full(2, 0.5, dtype=np.float32)
    for empty in (scan([], []), scan([0.0], [np.nan]), scan([0.0, 1.0], [RANGE_MAX, np.inf]), scan([np.nan], [1.0])):
        assert field.admit(particles, weights, empty) is None
        assert field.log_likelihood(particles, empty).tolist() == [0.0, 0.0]
    # Beside beams that tell something, those do not count.
    mixed = field.log_likelihood(particles, scan([0.0, 0.5, 1.0], [2.0, np.nan, RANGE_MAX]))
    np.testing.assert_array_equal(mixed, field.log_likelihood(particles, scan([0.0], [2.0])))


def test_a_beam_may_end_a_little_outside_the_grid():
    params = LikelihoodFieldParams()
    field = LikelihoodField(params, room())
    # The last cells of the grid are wall, their centres at x = 2.95; cell centres beyond them follow every 10 cm.
    for beyond in (1, 3):
        found = field.log_likelihood(pose(0.0, 3.55, 0.0), scan([0.0], [2.95 + 0.1 * beyond]))
        assert found[0] == pytest.approx(np.log(density(0.1 * beyond, params)), rel=1e-5)


def test_a_particle_off_the_map_is_as_likely_as_one_that_sees_nothing_it_knows():
    params = LikelihoodFieldParams()
    found = LikelihoodField(params, room()).log_likelihood(pose(500.0, -3e6, 0.2), scan([0.0, 1.0], [2.0, 3.0]))
    assert found[0] == pytest.approx(2 * np.log(params.z_rand / RANGE_MAX), rel=1e-5)


@pytest.mark.parametrize("aggregation", ["product", "cubes"])
def test_a_pose_that_is_no_number_is_impossible(aggregation):
    field = LikelihoodField(LikelihoodFieldParams(aggregation=aggregation), room())
    bad = [(np.nan, 0, 0), (0, np.inf, 0), (0, 0, np.nan), (np.inf, -np.inf, 0), (3e38, -3e38, 0), (0.5, 3.0, 0.0)]
    found = field.log_likelihood(np.array(bad, dtype=np.float32).T, scan([0.0, 1.0], [2.0, 1.0]))
    assert found[:-1].tolist() == [-np.inf] * 5
    assert np.isfinite(found[-1])


def test_beams_that_the_particles_agree_not_to_understand_are_left_out():
    skipping = LikelihoodField(LikelihoodFieldParams(beam_skip=BeamSkip(distance=0.3)), room())
    spread = 0.02 * Stream.of(1, "test", 0).normals(3, 200)
    cloud = pose(0.05, 3.55, 0.0) + spread
    weights = np.full(200, 1 / 200, dtype=np.float32)
    walls, person = ([0.0, np.pi], [2.9, 0.95]), ([np.pi / 4], [0.7])
    seen = scan(walls[0] + person[0], walls[1] + person[1])
    kept = skipping.admit(cloud, weights, seen)
    assert kept is not None
    expected = LikelihoodField(LikelihoodFieldParams(), room()).log_likelihood(cloud, scan(*walls))
    np.testing.assert_allclose(skipping.log_likelihood(cloud, kept), expected, rtol=1e-5)
    # Control: a robot that is lost understands no beam, and then none is left out.
    lost = skipping.admit(cloud + pose(1.0, -0.6, 0.0), weights, scan(*walls))
    assert lost is not None
    assert lost.x.size == 2


def test_columns_may_be_evaluated_in_any_batches():
    field = LikelihoodField(LikelihoodFieldParams(), room())
    cloud = pose(0.5, 3.0, 0.0) + 0.3 * Stream.of(2, "test", 0).normals(3, 1000)
    seen = scan(np.linspace(-1.5, 1.5, 30), np.linspace(1.0, 3.0, 30))
    whole = field.log_likelihood(cloud, seen)
    parts = [field.log_likelihood(part, seen) for part in np.split(cloud, [1, 300, 777], axis=1)]
    assert np.array_equal(whole, np.concatenate(parts))


@pytest.mark.parametrize(("change", "named"), [({"sigma_hit": 0.0}, "sigma_hit"), ({"tempering": 1.5}, "tempering")])
def test_parameters_are_checked(change, named):
    with pytest.raises(ValueError, match=rf"LikelihoodFieldParams\.{named} = "):
        LikelihoodField(LikelihoodFieldParams(**change), room())


def test_a_map_without_walls_is_refused():
    with pytest.raises(ValueError, match="occupied cell"):
        LikelihoodField(LikelihoodFieldParams(), OccupancyGrid(np.zeros((3, 3), dtype=np.uint8), 0.1))
