import numpy as np
import pytest

from dynpf.measurement.scan import Scan


def scan(ranges, angles=None):
    count = len(ranges)
    angles = np.linspace(-1.0, 1.0, count) if angles is None else angles
    return Scan(np.asarray(angles, dtype=np.float32), np.asarray(ranges, dtype=np.float32), 0.1, 8.0)


def test_beams_that_are_no_numbers_or_too_short_are_left_out():
    kept = scan([1.0, np.nan, -np.inf, 0.05, 0.1, 3.0], angles=[0.0, 0.1, 0.2, 0.3, 0.4, np.nan]).usable(60)
    np.testing.assert_array_equal(kept.angles, np.array([0.0, 0.4], np.float32))
    np.testing.assert_array_equal(kept.ranges, np.array([1.0, 0.1], np.float32))


def test_no_return_reads_the_greatest_range():
    np.testing.assert_array_equal(scan([np.inf, 81.0, 8.0, 7.0]).usable(60).ranges, np.array([8, 8, 8, 7], np.float32))


@pytest.mark.parametrize("beams", [1, 7, 60, 180, 181, 400])
def test_at_most_so_many_beams_are_kept_evenly_spaced_and_symmetric(beams):
    whole = scan(np.full(181, 2.0))
    kept = whole.usable(beams)
    assert len(kept.angles) == len(kept.ranges) == min(beams, 181)
    steps = np.diff(np.searchsorted(whole.angles, kept.angles))
    assert len(steps) == 0 or (steps.min() >= 1 and steps.max() - steps.min() <= 1)
    np.testing.assert_allclose(kept.angles[0] + kept.angles[-1], 0.0, atol=0.012)


def test_an_empty_scan_stays_empty():
    kept = scan([]).usable(60)
    assert kept.angles.shape == kept.ranges.shape == (0,)
    assert kept.angles.dtype == kept.ranges.dtype == np.float32


def test_beams_of_two_shapes_and_no_beams_at_all_are_refused():
    with pytest.raises(ValueError, match=r"angles \(2,\) and ranges \(3,\)"):
        scan([1.0, 1.0, 1.0], angles=[0.0, 0.1]).usable(60)
    with pytest.raises(ValueError, match="max_beams = 0"):
        scan([1.0]).usable(0)
