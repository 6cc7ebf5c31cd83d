"""The judge of a filter's health: what each figure leads to, and how long it takes."""

import math
from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynpf.filters.health import Health, HealthMemory, HealthParams, Signs, Status, Verdict

BEAMS = 60


def signs(log_likelihood: float = -1.0, *, readings: int = BEAMS, position: float = 0.1, **changed: Any) -> Signs:
    """Signs of a filter on its track, at a log-likelihood a reading; fields that differ by name."""
    good = Signs(
        covariance=np.diag([position**2, 0.01, 0.01]),
        n_eff=500.0,
        n=1000,
        log_evidence=readings * log_likelihood if readings else math.nan,
        readings=readings,
        modes=(0.97,),
    )
    return good._replace(**changed)


def judged(several: list[Signs], memory: HealthMemory | None = None, **params: Any) -> tuple[HealthMemory, Verdict]:
    judge = Health(HealthParams(**params))
    memory = judge.begin() if memory is None else memory
    verdicts = []
    for one in several:
        memory, verdict = judge.assess(memory, one)
        verdicts.append(verdict)
    return memory, verdicts[-1]


def test_a_filter_that_is_sure_and_explains_what_it_sees_is_tracking() -> None:
    _, verdict = judged([signs()] * 50)
    assert verdict.status is Status.TRACKING
    assert verdict.reason == "all figures are within their limits"
    assert verdict.figures.likelihood_ratio == pytest.approx(1.0)
    assert verdict.figures.position_sigma == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("one", "status", "reason"),
    [
        (signs(position=1.0), Status.UNCERTAIN, "position spread 1 m above 0.5 m"),
        (signs(position=9.0), Status.LOST, "position spread 9 m above 3 m"),
        (signs(covariance=np.diag([0.01, 0.01, 1.0])), Status.UNCERTAIN, "heading spread 1 rad above 0.35 rad"),
        (signs(covariance=np.full((3, 3), np.nan)), Status.LOST, "position spread nan"),
        (signs(modes=(0.5, 0.5)), Status.UNCERTAIN, "share of the heaviest mode 0.5 below 0.7"),
        (signs(modes=()), Status.UNCERTAIN, "share of the heaviest mode 0 below 0.7"),
        (signs(modes=None), Status.TRACKING, "within their limits"),
        (signs(n_eff=2.0), Status.UNCERTAIN, "effective share of particles 0.002 below 0.01"),
        (signs(-math.inf), Status.UNCERTAIN, "no particle explains the last 1 updates"),
        (signs(readings=0), Status.TRACKING, "within their limits"),
    ],
)
def test_each_figure_beyond_its_limit_decides_and_is_named(one: Signs, status: Status, reason: str) -> None:
    _, verdict = judged([one])
    assert verdict.status is status
    assert reason in verdict.reason


def test_the_spread_is_taken_along_its_longest_direction() -> None:
    narrow = np.array([[2.0, 1.9, 0.0], [1.9, 2.0, 0.0], [0.0, 0.0, 0.01]])
    _, verdict = judged([signs(covariance=narrow)])
    assert verdict.figures.position_sigma == pytest.approx(math.sqrt(np.linalg.eigvalsh(narrow[:2, :2])[1]))


def test_a_fall_of_the_likelihood_means_lost_and_being_lost_does_not_become_normal() -> None:
    memory, verdict = judged([signs(-1.0)] * 100 + [signs(-4.0)] * 40)
    assert verdict.status is Status.LOST
    assert "likelihood to its average" in verdict.reason
    memory, verdict = judged([signs(-4.0)] * 5000, memory)
    assert verdict.status is Status.LOST
    _, verdict = judged([signs(-1.0)] * 60, memory)
    assert verdict.status is Status.TRACKING


@settings(derandomize=True, deadline=None, max_examples=20)
@given(readings=st.integers(1, 1000))
def test_how_many_readings_an_update_has_makes_no_difference(readings: int) -> None:
    _, verdict = judged([signs(-1.0, readings=readings)] * 20 + [signs(-2.0, readings=readings)] * 20)
    # Slow: the mean of the 20, then 20 steps of 1/n; fast: 0.9^20 of the first remains.
    fast = 0.9**20 * math.exp(-1.0) + (1.0 - 0.9**20) * math.exp(-2.0)
    assert verdict.figures.log_likelihood == pytest.approx(math.log(fast))
    assert verdict.figures.likelihood_ratio == pytest.approx(fast / (0.5 * math.exp(-1.0) + 0.5 * math.exp(-2.0)))


def test_an_absolute_limit_catches_a_filter_that_was_never_right() -> None:
    assert judged([signs(-9.0)] * 20)[1].status is Status.TRACKING
    assert judged([signs(-9.0)] * 20, log_likelihood_lost=-5.0)[1].status is Status.LOST


def test_readings_that_are_refused_for_long_mean_unsure_then_lost() -> None:
    refusing = signs(readings=0, refused=BEAMS)
    assert judged([signs(), *[refusing] * 3])[1].status is Status.TRACKING
    assert judged([signs(), *[refusing] * 12])[1].status is Status.UNCERTAIN
    assert judged([signs(), *[refusing] * 40])[1].status is Status.LOST


def test_impossible_updates_in_a_row_mean_lost_and_one_possible_ends_the_row() -> None:
    impossible = signs(-math.inf)
    quick = partial(judged, likelihood_lost=0.0, likelihood_unsure=0.0, worse_after=1)
    assert quick([signs(), *[impossible] * 4])[1].status is Status.UNCERTAIN
    assert quick([signs(), *[impossible] * 5])[1].status is Status.LOST
    memory, _ = quick([signs(), *[impossible] * 5, signs()])
    assert memory.impossible == 0


def test_the_status_changes_only_when_assessments_in_a_row_agree() -> None:
    wide, good = signs(position=1.0), signs()
    memory, verdict = judged([good, wide, wide])
    assert verdict.status is Status.TRACKING
    assert "uncertain in 2 of 3 assessments" in verdict.reason
    assert judged([good], memory)[0].run == 0
    memory, verdict = judged([wide], memory)
    assert verdict.status is Status.UNCERTAIN
    memory, verdict = judged([good] * 9, memory)
    assert verdict.status is Status.UNCERTAIN
    assert judged([good], memory)[1].status is Status.TRACKING


def test_a_run_of_different_findings_agrees_on_the_mildest() -> None:
    _, verdict = judged([signs(), signs(position=9.0), signs(position=1.0), signs(position=9.0)])
    assert verdict.status is Status.UNCERTAIN


def test_a_row_of_alternating_signs_does_not_flicker() -> None:
    _, verdict = judged([signs(), *[signs(position=9.0), signs()] * 20])
    assert verdict.status is Status.TRACKING


def test_the_memory_can_be_kept_as_plain_numbers() -> None:
    before = [signs(-1.0 - 0.01 * k, refused=k) for k in range(30)]
    memory, _ = judged(before)
    kept = HealthMemory(*msgspec.msgpack.decode(msgspec.msgpack.encode(tuple(memory))))
    assert judged([signs(-3.0)] * 9, kept) == judged([signs(-3.0)] * 9, memory)


def test_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"HealthParams.alpha_fast = 2.0"):
        Health(HealthParams(alpha_fast=2.0))


def test_a_robot_found_elsewhere_is_kidnapped_if_it_was_on_its_track_and_else_lost() -> None:
    judge = HealthParams()
    memory, verdict = judged([signs()] * judge.better_after)
    memory, verdict = judged([signs(-5.0, jump=0.9)], memory)
    assert verdict.status is Status.KIDNAPPED
    assert "found elsewhere" in verdict.reason
    assert judged([signs()] * (judge.better_after - 1), memory)[1].status is Status.KIDNAPPED
    assert judged([signs()] * judge.better_after, memory)[1].status is Status.TRACKING
    assert judged([signs(), signs(-5.0, jump=0.9)])[1].status is Status.LOST
    assert judged([signs()] * judge.better_after + [signs(jump=0.4)])[1].status is Status.TRACKING


def test_a_map_does_not_fit_where_the_robot_is_found_again_and_again_or_nowhere() -> None:
    jumps = HealthParams().jumps_unfit
    assert judged([signs(-5.0, jump=0.9)] * jumps)[1].status is Status.MAP_DOES_NOT_FIT
    assert judged([signs(-5.0, jump=0.9)] * (jumps - 1))[1].status is Status.LOST
    # Nowhere explained as usual makes unsure by itself, and tells why another figure means lost.
    fine, nowhere = [signs()] * 30, signs(unfit=3)
    assert judged([*fine, *[nowhere] * 3])[1].status is Status.UNCERTAIN
    assert judged([*fine, *[nowhere._replace(log_evidence=-9.0 * BEAMS)] * 30])[1].status is Status.MAP_DOES_NOT_FIT
    assert judged([*fine, *[signs(-9.0)] * 30])[1].status is Status.LOST
