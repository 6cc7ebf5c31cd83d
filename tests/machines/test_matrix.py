"""The matrix finds what differs, and takes no setting for a proof that changes nothing."""

from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.record import record_inline

from checks.machines.report import details, row_of, table, verdict
from checks.machines.runs import Outcome, differences, run
from checks.machines.settings import CHOOSERS, DEFAULT, Processor, Setting, processor_settings
from checks.machines.worker import Done, Told, outcome_digest

HASWELL = Processor(
    "x86_64", frozenset(["pni", "ssse3", "sse4_2", "avx", "avx2", "fma"]), ("X86_V3",), ("AVX2", "AVX"), True
)


def told(**controls: str) -> Told:
    return Told(
        machine="x86_64", python="3", glibc=True, features=(), numpy_dispatched=(), opencv_line="", controls=controls
    )


def outcome(folder, seed: int, *, setting: Setting = DEFAULT, controls: dict[str, str]) -> Outcome:
    folder.mkdir()
    scenario = load_scenario("landmark-room", overrides=["max_ticks=3"], seed=seed)
    path = folder / "short.mcap"
    record_inline(scenario, path)
    done = {"short": Done(job="short", digest=outcome_digest(path))}
    return Outcome(setting, folder, told(**controls), done, "", 1.0)


MASK = Setting("mask", {"X": "1"}, ("numpy",))


def test_job_that_comes_out_otherwise_is_told_with_node_topic_tick_and_both_values(tmp_path):
    default = outcome(tmp_path / "a", 1, controls={"numpy": "1"})
    other = outcome(tmp_path / "b", 2, setting=MASK, controls={"numpy": "2"})
    row = row_of(default, other, differences(default, other, ["short"]))
    (found,) = row.different
    first = found.where[0]
    assert first.tick == 0
    assert first.a != first.b
    assert f"short: {first.node} {first.topic}, tick 0, {first.field}" in table([row])
    assert f"expected {first.a!r}, came out {first.b!r}" in "\n".join(details(row))
    assert verdict([row]).startswith("Different: 1 of 1")


def test_same_bytes_prove_something_only_where_a_control_changed(tmp_path):
    default = outcome(tmp_path / "a", 1, controls={"numpy": "1", "libm": "1"})
    for number, (controls, proves) in enumerate([({"numpy": "2", "libm": "1"}, 1), ({"numpy": "1", "libm": "2"}, 0)]):
        same = outcome(tmp_path / f"b{number}", 1, setting=MASK, controls=controls)
        row = row_of(default, same, differences(default, same, ["short"]))
        assert row.different == ()
        assert f"; {proves} of them" in verdict([row])
        assert ("no effect here" in table([row])) is (proves == 0)


def test_job_that_failed_or_was_not_reached_is_a_difference(tmp_path):
    default = outcome(tmp_path / "a", 1, controls={})
    failed = default._replace(done={"short": Done(job="short", error="ValueError: no")})
    killed = default._replace(done={}, failure="ended with -4: ")
    assert [one.note for one in differences(default, failed, ["short"])] == ["ValueError: no"]
    assert [one.note for one in differences(default, killed, ["short"])] == ["ended with -4: "]


def test_settings_are_those_that_the_processor_can_do():
    names = {one.name: one for one in processor_settings(HASWELL)}
    assert "OpenBLAS Haswell" in names
    assert "OpenBLAS SkylakeX" not in names
    assert names["NumPy's baseline"].environment == {"NPY_DISABLE_CPU_FEATURES": "X86_V3"}
    every = set().union(*(one.environment for one in names.values() if not one.name.startswith(("threads", "another"))))
    assert set(names["all masks"].environment) == every
    assert every <= set(CHOOSERS)
    other = {one.name for one in processor_settings(HASWELL._replace(machine="aarch64", features=frozenset(["asimd"])))}
    assert "OpenBLAS ARMV8" in other
    assert not any("IPP" in name or "libm" in name for name in other)


def test_choices_in_the_environment_do_not_reach_a_run(tmp_path, monkeypatch):
    told = [run(DEFAULT, [], tmp_path / "before").told]
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "X86_V3")
    monkeypatch.setenv("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2,-FMA")
    told.append(run(DEFAULT, [], tmp_path / "after").told)
    assert told[0] is not None
    assert told[0] == told[1]
