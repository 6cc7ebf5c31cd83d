"""A user's own classes in a scenario: found, made, held to their part, and told when anything of that fails."""

import contextlib
import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from dynpf_lab.cli.main import main
from dynpf_protocol.errors import ScenarioError
from dynpf_services.scenario.context import Context
from dynpf_services.scenario.load import load_scenario, override_resolved, with_user_code
from dynpf_services.scenario.schema import Scenario, resolved_json
from dynpf_systems.rooms.localization.components import localizer_of, measurements_of, motion_of
from dynpf_systems.rooms.localization.config import LocalizationConfig
from dynpf_systems.rooms.maps import NO_MAPS, Maps

from dynpf.motion import Arcs, ArcsParams

Modules = Callable[..., Path]
MOTION = Arcs(ArcsParams())

DRIFT = """
    from typing import Annotated
    import msgspec
    from msgspec import Meta
    from dynpf.motion.model import Displacement

    class DriftParams(msgspec.Struct, frozen=True):
        rate: Annotated[float, Meta(ge=0.0)] = 0.1

    class Drift:
        Params = DriftParams
        control = Displacement

        def __init__(self, params):
            self.params = params

        def particles(self, poses, stream):
            return poses

        def propagate(self, particles, control, stream):
            return particles + self.params.rate

    class Plain:
        called = []

        def __init__(self, gain=1.0):
            self.called.append(gain)

    class Mover(Plain):
        particles = propagate = lambda *_: None

    class Strange(Mover):
        Params = 3

    class Idle(Mover):
        uses = 3

    class Beacon:
        from dynpf.measurement.range_bearing import RangeBearingReadings as reading
        uses = ("landmarks",)

        def __init__(self, sigma, landmarks):
            self.sigma, self.landmarks = sigma, landmarks

        def admit(self, particles, weights, reading):
            return reading

        def log_likelihood(self, particles, reading):
            return -particles[0] ** 2

    NUMBER = 3
"""


@pytest.fixture(name="modules")
def write_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Modules:
    """Write modules into a folder on the Python path; they are forgotten when the test is over."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(sources: dict[str, str]) -> Path:
        for name, source in sources.items():
            path = tmp_path / f"{name}.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(dedent(source), encoding="utf-8")
            monkeypatch.delitem(sys.modules, name.replace("/", "."), raising=False)
        importlib.invalidate_caches()
        return tmp_path

    return write


def with_motion(table: str) -> Scenario:
    return load_scenario("landmark-room", overrides=[f"estimator.motion={{{table}}}"])


def user_classes(scenario: Scenario) -> dict[str, type]:
    return Context(scenario, "estimator").user_classes()


def config(scenario: Scenario) -> LocalizationConfig:
    assert isinstance(scenario.estimator, LocalizationConfig)
    return scenario.estimator


def test_the_keys_of_the_table_are_the_parameters_of_the_class(modules: Modules) -> None:
    modules({"lab_a": DRIFT})
    scenario = with_motion("kind='lab_a:Drift', rate=0.5")
    model: Any = motion_of(config(scenario), NO_MAPS, user_classes(scenario)).model
    assert model.params.rate == 0.5
    assert '"motion":{"kind":"lab_a:Drift","rate":0.5}' in resolved_json(scenario)
    again = override_resolved(resolved_json(scenario), ["estimator.motion.rate=0.7"], "")
    with pytest.raises(ScenarioError, match=r"did not come along; a recording runs no code .*: --allow-code lab_a$"):
        user_classes(again)
    again = with_user_code(again, "", ["lab_a"])
    model = motion_of(config(again), NO_MAPS, user_classes(again)).model
    assert model.params.rate == 0.7


def test_a_class_in_a_list_comes_back_from_the_resolved_text_as_it_went_in(modules: Modules) -> None:
    modules({"lab_j": DRIFT})
    tables = "[{kind='lab_j:Beacon', sigma=2}, {kind='position', sigma=0.1}]"
    scenario = load_scenario("landmark-room", overrides=[f"estimator.measurement={tables}"])
    assert config(override_resolved(resolved_json(scenario), [], "")) == config(scenario)


def test_a_class_without_params_is_given_the_keys_and_what_it_uses_of_the_run(modules: Modules) -> None:
    modules({"lab_b": DRIFT})
    scenario = load_scenario("landmark-room", overrides=["estimator.measurement=[{kind='lab_b:Beacon', sigma=2}]"])
    marks: Any = object()
    (model,) = measurements_of(config(scenario), Maps(landmarks=marks), user_classes(scenario)).values()
    beacon: Any = model
    assert beacon.sigma == 2
    assert beacon.landmarks is marks
    with pytest.raises(ScenarioError, match=r"measurement.0.kind: 'lab_b:Beacon' uses 'landmarks', which this run"):
        measurements_of(config(scenario), NO_MAPS, user_classes(scenario))


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ("kind='lab_c:Drift', rate=-1.0", "estimator.motion.rate: expected `float` >= 0.0"),
        ("kind='lab_c:Drift', rat=1.0", "estimator.motion.rat: unknown key; lab_c:Drift knows rate"),
        (
            "kind='lab_c:Mover', gian=1.0",
            "estimator.motion.kind: 'lab_c:Mover' cannot be made of the table's keys: .*gian",
        ),
        ("kind='lab_c:Strange'", "'lab_c:Strange' has Params = 3; expected a msgspec struct, or no Params"),
        ("kind='lab_c:Idle'", "'lab_c:Idle' has uses = 3; expected a tuple of names"),
        (
            "kind='lab_c:Plain'",
            "estimator.motion.kind: 'lab_c:Plain' lacks particles, propagate; expected a MotionModel, "
            "which has particles, propagate",
        ),
        ("kind='lab_c:Drft'", "estimator.motion.kind: 'lab_c:Drft': Drft is not in the module; did you mean 'Drift'?"),
        ("kind='lab_c:NUMBER'", "estimator.motion.kind: 'lab_c:NUMBER': NUMBER is no class"),
        ("kind='lab_d:Drift'", r"estimator.motion.kind: 'lab_d:Drift': .*ZeroDivisionError: .*lab_d.py:1\)"),
        ("kind='lab_e:Drift'", "its module needs the module 'no_such_thing', which is not installed"),
    ],
)
def test_what_does_not_fit_is_told_with_its_key(modules: Modules, table: str, told: str) -> None:
    modules({"lab_c": DRIFT, "lab_d": "1 / 0", "lab_e": "import no_such_thing"})
    scenario = with_motion(table)
    with pytest.raises(ScenarioError, match=told):
        motion_of(config(scenario), NO_MAPS, user_classes(scenario))


def test_a_class_is_called_only_if_it_has_the_methods_of_its_part(modules: Modules) -> None:
    modules({"lab_l": DRIFT})
    for name, calls in (("Plain", []), ("Mover", [2.0])):
        scenario = with_motion(f"kind='lab_l:{name}', gain=2.0")
        with contextlib.suppress(ScenarioError):
            motion_of(config(scenario), NO_MAPS, user_classes(scenario))
        assert sys.modules["lab_l"].Plain.called == calls


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (
            "no_such_lab:Drift",
            "no module 'no_such_lab' is beside the scenario or on the Python path; --code",
        ),
        (
            "no_such_lab.models:Drift",
            "no module 'no_such_lab' is beside the scenario or on the Python path; --code",
        ),
        ("lab_f.models:Drift", "no module 'lab_f.models' is beside the scenario or on the Python path"),
        ("lab f:Drift", "estimator.motion.kind: 'lab f:Drift'; expected package.module:Name"),
        ("sys:Drift", "sys is a module of Python's own, which holds no component; it is not imported"),
        ("this:Drift", "this is a module of Python's own"),
        ("__main__:Drift", "__main__ is a module of Python's own"),
        ("lab_k.models:Drift", r"the module cannot be imported: ZeroDivisionError: .*lab_k/__init__.py:1\)"),
    ],
)
def test_a_module_that_is_not_there_is_told_when_the_scenario_is_read(modules: Modules, kind: str, told: str) -> None:
    modules({"lab_f/__init__": "", "lab_k/__init__": "1 / 0"})
    with pytest.raises(ScenarioError, match=rf"landmark-room.toml: estimator.motion.kind: .*{told}|{told}"):
        with_motion(f"kind='{kind}'")


def test_the_digest_is_that_of_the_whole_package_and_of_nothing_beside_it(modules: Modules) -> None:
    def digest() -> str:
        return with_motion("kind='lab_g.models:Drift'").user_code["lab_g.models"]

    modules({"lab_g/__init__": "", "lab_g/models": DRIFT, "lab_g/helpers": "x = 1", "beside": "x = 1"})
    first = digest()
    modules({"beside": "x = 2"})
    assert digest() == first
    modules({"lab_g/helpers": "x = 2"})
    assert digest() != first


def test_a_resampling_scheme_of_ones_own_is_held_to_its_part(modules: Modules) -> None:
    modules({"lab_h": "class Never:\n    def due(self, cloud):\n        return False\n"})
    scenario = load_scenario("landmark-room", overrides=["estimator.resampling={kind='lab_h:Never'}"])
    with pytest.raises(ScenarioError, match="'lab_h:Never' lacks select; expected a Resampling, which has due, select"):
        localizer_of(config(scenario), MOTION, {}, NO_MAPS, user_classes(scenario))


WALK = """
    import numpy as np

    class Walk:
        def __init__(self, step):
            self.step = step

        def particles(self, poses, stream):
            return poses

        def propagate(self, particles, control, stream):
            moved = particles + np.float32(self.step) * stream.normals(*particles.shape)
            moved[0] += np.float32(control.v * control.duration) * np.cos(moved[2])
            moved[1] += np.float32(control.v * control.duration) * np.sin(moved[2])
            moved[2] += np.float32(control.w * control.duration)
            return moved
"""


def test_a_run_with_a_users_model_replays_and_tells_when_the_model_has_changed(
    modules: Modules, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    modules({"lab_i": WALK})
    path = tmp_path / "run.mcap"
    words = ["--set", "max_ticks=12", "--set", "estimator.motion={kind='lab_i:Walk', step=0.01}"]
    assert main(["run", "landmark-room", "--runner", "inline", *words, "-o", str(path)]) == 0
    assert main(["replay", str(path), "--allow-code", "lab_i"]) == 0
    assert "lab_i" not in capsys.readouterr().err
    assert main(["replay", str(path)]) == 2
    assert capsys.readouterr().err == (
        f"dynpf replay: {path}: estimator.motion.kind: names the class Walk of the module lab_i, which did not come "
        "along; a recording runs no code of your computer unless you allow it: --allow-code lab_i\n"
    )

    modules({"lab_i": WALK.replace("self.step = step", "self.step = 2 * step")})
    assert main(["replay", str(path), "--json", "--allow-code", "lab_i"]) == 1
    told = capsys.readouterr()
    assert "the module lab_i has changed since the run was recorded" in told.err
    assert json.loads(told.out)["first"]["node"] == "estimator"

    modules({"lab_i": ""})  # forgotten, too
    (tmp_path / "lab_i.py").unlink()
    assert main(["replay", str(path), "--allow-code", "lab_i"]) == 2
    assert (
        "estimator.motion.kind: 'lab_i:Walk': no module 'lab_i' is beside the scenario or on the Python path"
        in capsys.readouterr().err
    )
