"""Random streams: Philox's published answers, the distributions drawn from it, and independence of what is drawn."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from dynpf.kernels.compiler import kernel
from dynpf.kernels.philox import words as kernel_words
from dynpf.reference import philox
from dynpf.rng import Stream, generator

# Known answers of philox4x32-10, from the Random123 distribution: counter, key, words.
ONES = 0xFFFFFFFF
ANSWERS = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((ONES, ONES, ONES, ONES), (ONES, ONES), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@kernel
def words_of(counters, key, results):
    for i in range(counters.shape[1]):
        results[0, i], results[1, i], results[2, i], results[3, i] = kernel_words(
            counters[0, i], counters[1, i], counters[2, i], counters[3, i], key[0], key[1]
        )


streams = st.builds(
    Stream,
    key=st.integers(0, 2**63 - 1),
    step=st.integers(0, 2**63 - 1),
    first=st.integers(0, 2**32 - 1000),
)


@pytest.mark.parametrize(("counter", "key", "words"), ANSWERS)
def test_words_are_the_published_ones(counter: tuple[int, ...], key: tuple[int, int], words: tuple[int, ...]) -> None:
    counters = np.array(counter, dtype=np.uint64)[:, None]
    assert philox.words(counters, key)[:, 0].tolist() == list(words)
    drawn = np.empty((4, 1), dtype=np.uint32)
    words_of(counters.astype(np.uint32), np.array(key, dtype=np.uint32), drawn)
    assert drawn[:, 0].tolist() == list(words)


@settings(max_examples=30, deadline=None)
@given(streams, st.integers(1, 9), st.sampled_from([1, 3, 255, 256, 257]))
def test_uniforms_are_those_of_the_reference_bit_for_bit(stream: Stream, rows: int, count: int) -> None:
    reference = philox.uniforms((rows, count), stream.first, stream.step, stream.key)
    assert np.array_equal(stream.uniforms(rows, count), reference)


@settings(max_examples=30, deadline=None)
@given(streams, st.sampled_from([2, 4, 6]), st.sampled_from([1, 257]))
def test_normals_are_those_of_the_reference_up_to_rounding(stream: Stream, rows: int, count: int) -> None:
    found = stream.normals(rows, count)
    exact = philox.normals((rows, count), stream.first, stream.step, stream.key)
    radius = np.repeat(np.hypot(exact[0::2], exact[1::2]), 2, axis=0)
    # The radius: a unit in the last place of log, half of it after the root, two more roundings. Its direction, up to
    # 2 pi: the roundings of 2 pi and of the product, 1.7e-7 and 2.4e-7, and 1e-7 of sine and cosine.
    assert np.all(np.abs(found - exact) <= radius * (2.0 * 2.0**-24 + 5.2e-7))


def test_a_scalar_is_made_of_53_bits_of_the_words() -> None:
    stream = Stream.of(1, "node", 2, "comb")
    counter = np.array([[0], [0], [2], [0]], dtype=np.uint64)
    high, low, _, _ = (int(word) for word in philox.words(counter, (stream.key & ONES, stream.key >> 32))[:, 0])
    assert stream.uniform() == ((high >> 5) * 2**26 + (low >> 6)) / 2**53


def test_normals_have_the_moments_and_the_distribution_of_normal_numbers() -> None:
    drawn = Stream.of(1, "test", 0).normals(4, 100_000).astype(float)
    for row in drawn:
        error = np.sqrt(np.array([1.0, 2.0, 15.0, 96.0]) / row.size)
        moments = np.array([np.mean(row**power) for power in (1, 2, 3, 4)])
        assert np.all(np.abs(moments - [0.0, 1.0, 0.0, 3.0]) < 5.0 * error)
        assert stats.kstest(row, "norm").pvalue > 1e-3
    assert np.abs(drawn).max() < 6.7


def test_uniforms_fill_the_interval_evenly_and_leave_out_one() -> None:
    drawn = Stream.of(1, "test", 0).uniforms(5, 100_000)
    for row in drawn.astype(float):
        assert stats.kstest(row, "uniform").pvalue > 1e-3
    assert drawn.min() >= 0.0
    assert drawn.max() < 1.0
    assert np.array_equal(drawn.astype(float) * 2**24, np.rint(drawn.astype(float) * 2**24))


def test_scalars_of_many_steps_are_uniform() -> None:
    drawn = np.array([Stream.of(1, "test", step, "comb").uniform() for step in range(5000)])
    assert stats.kstest(drawn, "uniform").pvalue > 1e-3
    assert drawn.min() >= 0.0
    assert drawn.max() < 1.0


def test_the_test_of_distribution_would_notice_a_wrong_one() -> None:
    """A control: two hundredths too wide, and a mean two hundredths off."""
    drawn = Stream.of(1, "test", 0).normals(1, 100_000)[0].astype(float)
    assert stats.kstest(drawn * 1.02, "norm").pvalue < 1e-3
    assert stats.kstest(drawn + 0.02, "norm").pvalue < 1e-3


def correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    return float(np.corrcoef(a, b)[0, 1])


def test_streams_that_differ_in_anything_are_uncorrelated() -> None:
    count = 50_000
    base = Stream.of(1, "node", 5, "motion")
    others = {
        "seed": Stream.of(2, "node", 5, "motion"),
        "node": Stream.of(1, "edon", 5, "motion"),
        "step": Stream.of(1, "node", 6, "motion"),
        "high step": Stream.of(1, "node", 5 + 2**32, "motion"),
        "purpose": Stream.of(1, "node", 5, "resampling"),
        "part": base.part("motion"),
        "part of another name": base.part("noise"),
        "particle": base.starting_at(1),
    }
    drawn = base.normals(1, count)[0]
    for name, other in others.items():
        assert abs(correlation(drawn, other.normals(1, count)[0])) < 5.0 / np.sqrt(count), name
    assert len({base, *others.values()}) == len(others) + 1
    # A control: what is the same stream is perfectly correlated.
    assert correlation(drawn, Stream.of(1, "node", 5, "motion").normals(1, count)[0]) == pytest.approx(1.0)


def test_the_rows_of_a_draw_are_uncorrelated_and_so_are_their_squares() -> None:
    count = 50_000
    rows = Stream.of(3, "node", 0).normals(8, count).astype(float)
    off_diagonal = ~np.eye(8, dtype=bool)
    for values in (rows, rows**2):
        assert np.abs(np.corrcoef(values)[off_diagonal]).max() < 5.0 / np.sqrt(count)


def test_particles_keep_their_numbers_in_whatever_batches_and_order_they_are_drawn() -> None:
    stream = Stream.of(4, "node", 9, "motion")
    whole_normals, whole_uniforms = stream.normals(6, 1000), stream.uniforms(6, 1000)
    for size in (1, 7, 256, 300):
        starts = list(range(0, 1000, size))
        for start in reversed(starts):
            count = min(size, 1000 - start)
            batch = stream.starting_at(start)
            assert np.array_equal(batch.normals(6, count), whole_normals[:, start : start + count])
            assert np.array_equal(batch.uniforms(6, count), whole_uniforms[:, start : start + count])
    assert stream.starting_at(3).starting_at(4) == stream.starting_at(7)


def test_fewer_rows_or_columns_are_a_part_of_more() -> None:
    stream = Stream.of(5, "node", 0)
    assert np.array_equal(stream.normals(2, 10), stream.normals(7, 300)[:2, :10])
    assert stream.normals(3, 0).shape == (3, 0)
    assert stream.uniforms(0, 4).shape == (0, 4)


def test_any_integer_is_a_seed_and_any_particle_number_fits() -> None:
    assert Stream.of(-1, "node", 0) == Stream.of(2**64 - 1, "node", 0)
    assert np.isfinite(Stream.of(2**64 - 1, "node", 2**63 - 1, "p" * 100).starting_at(2**31).normals(4, 4)).all()


def test_generators_repeat_themselves_and_differ_by_each_part_of_their_key() -> None:
    first = generator(1, "node", 2, "purpose").random(4).tolist()
    assert generator(1, "node", 2, "purpose").random(4).tolist() == first
    keys = [(2, "node", 2, "purpose"), (1, "edon", 2, "purpose"), (1, "node", 3, "purpose"), (1, "node", 2, "other")]
    assert all(generator(*key).random(4).tolist() != first for key in keys)
