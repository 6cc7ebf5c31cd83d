from itertools import pairwise

import msgspec
import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from dynpf.maps.occupancy import OCCUPIED, UNKNOWN, OccupancyGrid
from dynpf.maps.raycast import RayCaster
from dynpf.measurement.beam import BeamModel, BeamParams, densities
from dynpf.measurement.scan import Scan
from dynpf.reference import beam as reference
from dynpf.reference import rays

RANGE_MAX = 8.0


def shares(params):
    return params.z_hit, params.z_short, params.z_max, params.z_rand


def exact(params, readings, lengths):
    return reference.sum_over_beams(
        np.asarray(readings, dtype=float),
        np.asarray(lengths, dtype=float),
        RANGE_MAX,
        shares(params),
        (params.sigma_hit, params.lambda_short),
    )


def room(origin=(0.0, 0.0, 0.0)):
    """A room of 6 m x 4 m with a pillar, unknown cells in one corner."""
    cells = np.zeros((80, 120), dtype=np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = OCCUPIED
    cells[30:38, 50:60] = OCCUPIED
    cells[60:70, 100:110] = UNKNOWN
    return OccupancyGrid(cells, 0.05, origin)


def scan(ranges, angles=None):
    angles = np.linspace(-2.0, 2.0, len(ranges)) if angles is None else angles
    return Scan(np.asarray(angles, dtype=np.float32), np.asarray(ranges, dtype=np.float32), 0.05, RANGE_MAX)


def particles(grid, count, seed):
    draw = np.random.default_rng(seed)
    row, column = np.nonzero(grid.free)
    at = draw.integers(0, row.size, count)
    x, y = grid.to_map(column[at] + draw.uniform(0.01, 0.99, count), row[at] + draw.uniform(0.01, 0.99, count))
    return np.stack((x, y, draw.uniform(-3.0, 3.0, count))).astype(np.float32)


@pytest.mark.parametrize("length", [0.03, 1.0, 7.9, RANGE_MAX])
@pytest.mark.parametrize(("sigma", "decay"), [(0.15, 0.5), (3.0, 4.0), (0.02, 1e-6)])
def test_the_density_with_the_mass_of_the_maximum_sums_to_one(length, sigma, decay):
    weights = (0.6, 0.15, 0.05, 0.2)
    edges = np.unique(np.clip([0.0, length - 6 * sigma, length, length + 6 * sigma, RANGE_MAX], 0.0, RANGE_MAX))
    integral = sum(
        quad(lambda z: reference.density(z, length, RANGE_MAX, weights, (sigma, decay)), low, high)[0]
        for low, high in pairwise(edges)
    )
    assert integral + 0.05 == pytest.approx(1.0, abs=1e-7)


def test_the_parts_are_the_truncated_distributions_of_the_book():
    z, length = (a.ravel() for a in np.meshgrid(np.linspace(0.0, RANGE_MAX, 33), [0.05, 0.5, 4.0, 7.9, RANGE_MAX]))
    hit, short, at_max, rand = densities(z, length, RANGE_MAX, 0.4, 0.7)
    gauss = stats.truncnorm(-length / 0.4, (RANGE_MAX - length) / 0.4, loc=length, scale=0.4)
    np.testing.assert_allclose(hit, gauss.pdf(z), rtol=1e-9, atol=1e-300)
    np.testing.assert_allclose(short, stats.truncexpon(length * 0.7, scale=1 / 0.7).pdf(z), rtol=1e-9)
    np.testing.assert_array_equal(at_max, z == RANGE_MAX)
    np.testing.assert_array_equal(rand, np.where(z == RANGE_MAX, 0.0, 1.0 / RANGE_MAX))
    assert densities(np.zeros(1), np.zeros(1), RANGE_MAX, 0.4, 0.7)[1] == 0.0


@pytest.mark.parametrize("params", [BeamParams(), BeamParams(z_hit=0.1, z_short=0.6, z_rand=0.25, lambda_short=2.0)])
def test_the_table_is_as_close_to_the_density_as_it_says(params):
    readings = np.array([0.05, 1.3, 4.0, 7.9, RANGE_MAX], np.float32)
    table = BeamModel(params, room()).admit(np.zeros((3, 1)), np.ones(1), scan(readings))
    assert table is not None
    spacing = 1.0 / table.per_length
    assert spacing <= min(0.025, params.sigma_hit / 8) + 1e-9
    lengths = np.linspace(0.0, RANGE_MAX, 2001)
    nodes = np.linspace(0.0, RANGE_MAX, table.log_densities.shape[1])
    for reading, logs in zip(readings, table.log_densities, strict=True):
        interpolated = np.interp(lengths, nodes, logs)
        right = exact(params, [reading], lengths[None])
        away = (np.abs(lengths - reading) > spacing) & (lengths > 2 * spacing)
        assert np.abs(interpolated - right)[away].max() < 0.01
        node = np.minimum((lengths / spacing).astype(int), nodes.size - 2)
        ends = exact(params, [reading], nodes[None])
        low, high = np.minimum(ends[node], ends[node + 1]), np.maximum(ends[node], ends[node + 1])
        assert ((low - 1e-5 <= interpolated) & (interpolated <= high + 1e-5)).all()


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-4.0, 2.5, 1.1)])
def test_log_likelihood_is_that_of_exact_rays_from_where_the_sensor_is(origin):
    grid = room(origin)
    params = BeamParams(sensor_x=0.12, sensor_y=-0.05, sensor_theta=0.4, tempering=0.5)
    poses = particles(grid, 300, 1)
    angles = np.array([-1.5, -0.2, 0.9, 2.8], np.float32)
    readings = np.array([1.0, 2.5, 0.4, RANGE_MAX], np.float32)
    x, y, theta = poses.astype(float)
    sensor_x = x + np.cos(theta) * 0.12 + np.sin(theta) * 0.05
    sensor_y = y + np.sin(theta) * 0.12 - np.cos(theta) * 0.05
    column, row = grid.to_cells(sensor_x, sensor_y)
    directions = theta + 0.4 + angles[:, None].astype(float) - origin[2]
    lengths = [rays.cast(grid.occupied, column, row, direction, RANGE_MAX / 0.05) * 0.05 for direction in directions]
    got = BeamModel(params, grid).log_likelihood(poses, scan(readings, angles))
    expected = 0.5 * exact(params, readings, np.stack(lengths))
    assert got.dtype == np.float32
    # Where a length differs from the reading by a node or less the table may be farther off: p_short sets in there.
    close = np.abs(got - expected) < 0.02
    assert np.mean(close) > 0.98
    np.testing.assert_allclose(got, expected, atol=0.1)
    assert np.ptp(expected) > 3.0


def test_the_pose_where_a_scan_was_taken_is_the_likeliest():
    grid, angles = room(), np.linspace(-3.0, 3.0, 90)
    truth = np.array([1.3, 2.2, 0.3])
    ranges = RayCaster(grid).ranges(np.full(90, 1.3), np.full(90, 2.2), angles + 0.3, RANGE_MAX)
    cloud = np.concatenate((truth[:, None], particles(grid, 2000, 2)), axis=1)
    assert np.argmax(BeamModel(BeamParams(), grid).log_likelihood(cloud, scan(ranges, angles))) == 0


def test_particles_in_walls_off_the_map_or_nowhere_are_impossible_and_in_the_unknown_they_are_not():
    model = BeamModel(BeamParams(), room())
    poses = np.array([[1.0, 1.0, 0.0], [2.7, 1.7, 0.0], [-0.01, 1.0, 0.0], [1.0, 4.01, 0.0], [5.2, 3.2, 0.0]])
    odd = np.array([[np.nan, 1.0, 0.0], [1.0, np.inf, 0.0], [1.0, 1.0, np.nan], [1.0, 1.0, -np.inf]])
    got = model.log_likelihood(np.concatenate((poses, odd)).T, scan([1.0, 2.0, np.nan]))
    np.testing.assert_array_equal(np.isfinite(got), [True, False, False, False, True, False, False, False, False])
    assert (got[~np.isfinite(got)] == -np.inf).all()


@pytest.mark.parametrize(
    "nothing", [scan([]), scan([np.nan, np.nan]), scan([1.0])._replace(range_max=np.nan), scan([0.01])]
)
def test_a_scan_that_tells_nothing_is_not_admitted_and_makes_no_difference(nothing):
    model, poses = BeamModel(BeamParams(), room()), np.full((3, 4), -9.0)
    assert model.admit(poses, np.full(4, 0.25), nothing) is None
    np.testing.assert_array_equal(model.log_likelihood(poses, nothing), np.zeros(4, dtype=np.float32))


def test_what_is_admitted_is_worth_what_the_scan_is_in_any_batches():
    grid = room()
    model, poses = BeamModel(BeamParams(max_beams=20), grid), particles(grid, 1500, 3)
    reading = scan(np.random.default_rng(4).uniform(0.1, 9.0, 181))
    whole = model.log_likelihood(poses, reading)
    admitted = model.admit(poses, np.full(1500, 1 / 1500), reading)
    assert admitted is not None
    assert model.count(admitted) == 20
    pieces = [model.log_likelihood(poses[:, i : i + 333], admitted) for i in range(0, 1500, 333)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


def test_shares_that_do_not_sum_to_one_and_scales_out_of_range_are_refused():
    with pytest.raises(ValueError, match="must to 1"):
        BeamParams(z_hit=0.9)
    with pytest.raises(msgspec.ValidationError, match="must to 1"):
        msgspec.convert({"kind": "beam", "z_hit": 0.9}, BeamParams)
    with pytest.raises(ValueError, match=r"BeamParams.sigma_hit = 0.0"):
        BeamModel(BeamParams(sigma_hit=0.0), room())
    with pytest.raises(ValueError, match=r"BeamParams.max_beams = 0"):
        BeamModel(BeamParams(max_beams=0), room())
