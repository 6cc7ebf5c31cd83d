import pytest
from dynpf_lab.bench import measure
from dynpf_lab.bench.measure import Plan, Timer, exponent, interleaved
from dynpf_lab.bench.report import text

from tests.unit.bench.test_plain import box


def test_contenders_take_turns_and_medians_are_of_one_update() -> None:
    called: list[str] = []

    def takes(name: str, ms: float) -> Timer:
        def seconds(updates: int) -> float:
            called.append(name)
            return 1e-3 * ms * updates

        return seconds

    timings = interleaved({"ours": takes("ours", 2.0), "numpy": takes("numpy", 30.0)}, budget_s=0.5)
    assert timings["ours"].ms == pytest.approx(2.0)
    assert timings["numpy"].ms == pytest.approx(30.0)
    assert called[4:] == ["ours", "numpy"] * 10


def test_cost_that_grows_with_n_has_the_exponent_one() -> None:
    assert exponent([10, 100, 1000], [0.3, 3.0, 30.0]) == pytest.approx(1.0)
    assert exponent([10], [0.3]) is None


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "BUDGET_S", 0.001)
    monkeypatch.setattr(measure, "TURN_S", 1e-6)


@pytest.mark.usefixtures("brief")
def test_a_row_tells_times_ratios_parts_and_memory() -> None:
    rows = list(measure.measure(Plan(["likelihood_field_5"], [300, 200], None, 2), box(), [], lambda _: None))
    assert [(row["work"], row["n"], row["beams"], row["threads"]) for row in rows] == [
        ("likelihood_field_5", n, 5, threads) for n in (200, 300) for threads in (1, 2)
    ]
    for row in rows:
        assert row["ratio_numpy"] == row["numpy_ms"] / row["ours_ms"] > 0.0
        assert row["particles_ms"] is row["ratio_particles"] is None
        assert row["bytes_per_particle"] == 20.0  # x, y, theta, weight and its logarithm
        assert row["peak_bytes_per_particle"] > 0.0
        assert sum(row[f"{stage}_ms"] for stage in measure.STAGES) > 0.0
    shown = text(rows)
    assert "cost ~ N^" in shown
    assert "particles ms" not in shown


@pytest.mark.usefixtures("brief")
def test_a_comparison_that_would_take_long_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "TOO_SLOW_S", 0.0)
    rows = list(measure.measure(Plan(["rays_track"], [100, 200], None, 2), box(), [], lambda _: None))
    assert [row["numpy_ms"] is None for row in rows] == [False, True]
