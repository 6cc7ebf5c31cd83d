import math
from functools import partial

import msgspec
import pytest
from dynpf_runtime.faults import Fault, FaultyLink, LeftOut

TOPIC, OTHER = "sensors/odometry", "sensors/landmarks"
COUNT = 4000


def fates(link: FaultyLink, topic: str = TOPIC, count: int = 200) -> list[int | None]:
    return [link.delay_ns(topic, sequence, 0) for sequence in range(count)]


def link(seed: int = 1, to: str = "estimator", **faults: float) -> FaultyLink:
    return FaultyLink([Fault(topic=topic, to=to, **faults) for topic in (TOPIC, OTHER)], to, seed)


def test_the_fate_of_a_message_depends_on_seed_topic_and_sequence_alone() -> None:
    shaky = partial(link, loss=0.3, jitter_s=0.2)
    first = fates(shaky())
    backwards = shaky()
    fates(backwards, OTHER)
    assert [backwards.delay_ns(TOPIC, sequence, 0) for sequence in reversed(range(200))] == first[::-1]
    assert fates(shaky(seed=2)) != first
    assert fates(shaky(), OTHER) != first
    assert fates(shaky(to="controller")) != first


def test_the_share_of_losses_is_that_asked_for() -> None:
    for loss in (0.05, 0.5, 0.9):
        lost = fates(link(loss=loss), count=COUNT).count(None)
        assert abs(lost - loss * COUNT) < 4.5 * math.sqrt(COUNT * loss * (1 - loss))


@pytest.mark.parametrize(("loss", "lost"), [(0.0, 0), (1.0, COUNT)])
def test_none_or_all_are_lost(loss: float, lost: int) -> None:
    assert fates(link(loss=loss), count=COUNT).count(None) == lost


def test_delays_lie_evenly_within_their_bounds() -> None:
    delays = [delay for delay in fates(link(loss=0.5, delay_s=0.1, jitter_s=0.4), count=COUNT) if delay is not None]
    assert min(delays) >= 100_000_000
    assert max(delays) <= 500_000_000
    # The mean of n draws from an interval of length L has the standard deviation L / sqrt(12 n).
    assert abs(sum(delays) / len(delays) - 300_000_000) < 4.5 * 400_000_000 / math.sqrt(12 * len(delays))
    assert set(fates(link(delay_s=0.1))) == {100_000_000}


def test_other_topics_and_other_nodes_are_spared() -> None:
    faults = [Fault(topic=TOPIC, to="estimator", loss=1.0)]
    assert set(fates(FaultyLink(faults, "estimator", 1), OTHER)) == {0}
    assert set(fates(FaultyLink(faults, "controller", 1))) == {0}
    assert set(fates(FaultyLink(faults, "estimator", 1))) == {None}


@pytest.mark.parametrize("wrong", [{"loss": 1.1}, {"loss": -0.1}, {"delay_s": -1.0}, {"jitter_s": -1.0}, {"lost": 0.5}])
def test_impossible_faults_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"topic": TOPIC, "to": "estimator", **wrong}, Fault)


def test_what_is_left_out_is_lost_in_its_stretch_alone_and_other_faults_stay() -> None:
    late = [Fault(topic=TOPIC, to="estimator", delay_s=0.25)]
    left_out = [LeftOut(TOPIC, "estimator", 10, 20), LeftOut(OTHER, "controller", 0, 100)]
    with_stretch = FaultyLink(late, "estimator", 1, left_out)
    fates_by_stamp = [with_stretch.delay_ns(TOPIC, 0, stamp_ns) for stamp_ns in (9, 10, 19, 20)]
    assert fates_by_stamp == [250_000_000, None, None, 250_000_000]
    assert with_stretch.delay_ns(OTHER, 0, 15) == 0
