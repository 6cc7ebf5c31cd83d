"""A recording is data: whatever it names, no command imports, starts or opens what did not come along with it."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import msgspec
import numpy as np
import pytest
from dynpf_formats.recording.attachments import FOLDER
from dynpf_formats.recording.header import Attachment
from dynpf_formats.recording.reader import read_recording
from dynpf_formats.recording.writer import RecordingWriter
from dynpf_lab.cli.main import main
from dynpf_lab.references.check import check_part
from dynpf_lab.references.table import Entry, Made, Table
from dynpf_protocol.envelope import Envelope

from tests.integration import audited

ROOT = Path(__file__).parents[2]
Raw = dict[str, Any]
Change = Callable[[Raw], object]

# Leaves a mark when it is imported, and would make a motion model if it were called.
EVIL = """
import os
from pathlib import Path

Path({mark!r}).touch()
os.system("true")


class Model:
    def __init__(self, **_):
        pass

    def particles(self, poses, stream):
        return poses

    def propagate(self, particles, control, stream):
        return particles
"""
YAML = "image: {}\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
ROOM = """
title = "A room"
tick_s = 0.1
max_ticks = 4
[map]
kind = "occupancy"
file = "room.yaml"
[simulator]
kind = "room"
start = [1.0, 1.0, 0.0]
[sensors]
kind = "simulated"
[sensors.odometry]
[sensors.scan]
beams = 5
[estimator]
kind = "localization"
n = 20
start = { kind = "known", x = 1.0, y = 1.0 }
measurement = "likelihood_field"
"""
LASER_LOG = """\
ODOM 0 0 0 0 0 0 1.0 h 1.0
ODOM 1 0 0 0 0 0 2.0 h 2.0
FLASER 2 1 70 1 0 0 1 0 0 2.0 h 2.0
"""
PLAYS_A_LOG = """
title = "A log"
needs_log = true
[sensors]
kind = "log"
[estimator]
kind = "localization"
n = 20
start = { kind = "known" }
[[estimator.measurement]]
kind = "likelihood_field"
"""

KINDS = (
    "subprocess:Popen",
    "os:system",
    "this:X",
    "antigravity:X",
    "builtins:exec",
    "pathlib:Path",
    "importlib:import_module",
    "concurrent.futures:ThreadPoolExecutor",
    "__main__:Model",
    "evil:Model",
    "evil_pack:Model",
    "evil_pack.models:Model",
    "evil_pack.models.deep:Model",
    "dynpf_lab.cli.main:main",
    "numpy:ndarray",
    "evil:Model:more",
    ".evil:Model",
    "../evil:Model",
    "evil.py:Model",
    "evil :Model",
    "evil\n:Model",
    ":Model",
    "evil:",
)
SECTIONS = ("filter", "motion", "measurement", "resampling", "proposal", "regularization", "adaptation")
REPLAYS = (
    ("replay", "{}"),
    ("replay", "{}", "--json"),
    ("replay", "{}", "--node", "estimator"),
    ("replay", "{}", "--set", "estimator.n=30"),
    ("replay", "{}", "--node", "estimator", "--set", "estimator.n=30"),
    ("replay", "{}", "--set", "user_code.evil=0", "--set", "estimator.n=30"),
    ("replay", "{}", "--allow-code", "evil.models", "--allow-code", "subprocess", "--allow-code", "mylab"),
)
OTHERS = (
    ("info", "{}"),
    ("info", "{}", "--json"),
    ("doctor", "{}"),
    ("doctor", "{}", "--json"),
    ("metrics", "{}"),
    ("metrics", "{}", "--json"),
    ("fit", "{}"),
    ("diff", "{}", "{base}"),
    ("diff", "{base}", "{}", "--json"),
    ("export", "{}", "--format", "tum"),
    ("export", "{}", "--format", "csv"),
    ("recover", "{}", "-o", "{out}"),
    ("play", "{}", "--topics", "none"),
    ("replay", "{}", "--node", "simulator"),
    ("replay", "{}", "--node", "simulator", "-o", "{out}"),
    ("replay", "{}", "-o", "{out}"),
    ("run", "laser-log", "--log", "{}", "-o", "{out}"),
    ("service", "sensors", "laser-log", "--log", "{}"),
)


class Told(NamedTuple):
    """What came of a command, as ``audited`` tells it."""

    words: list[str]
    code: int
    out: str
    err: str
    imported: frozenset[str]
    opened: frozenset[str]
    started: tuple[str, ...]


class Lab:
    """A folder with a stranger's recordings, modules and files, all within reach of the Python path and of the disk."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mark = folder / "MARK"
        self.own = folder / "temporary"
        self.own.mkdir()
        self._count = 0
        for name in ("evil.py", "evil_pack/__init__.py", "evil_pack/models/__init__.py", "evil_pack/models/deep.py"):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(EVIL.format(mark=str(self.mark)))
        self.secret = folder / "secret.png"
        pixels = np.full((40, 40), 254, dtype=np.uint8)
        pixels[[0, -1]] = pixels[:, [0, -1]] = 0
        cv2.imwrite(str(self.secret), pixels)
        (folder / "secret.yaml").write_text(YAML.format("secret.png"))
        (folder / "link.png").symlink_to(self.secret)
        os.mkfifo(folder / "fifo")
        (folder / "room.yaml").write_text(YAML.format("room.png"))
        cv2.imwrite(str(folder / "room.png"), pixels)
        (folder / "room.toml").write_text(ROOM)
        (folder / "log.toml").write_text(PLAYS_A_LOG)
        (folder / "log.txt").write_text(LASER_LOG)
        self.bases = {name: folder / f"{name}.mcap" for name in ("marks", "room", "tube", "log")}
        short = ("--runner", "inline", "--set")
        landmarks, drawn = ("landmark-room", *short, "max_ticks=4"), ("colon-own-maps", *short, "max_ticks=2")
        assert main(["run", *landmarks, "-o", str(self.bases["marks"])]) == 0
        assert main(["run", str(folder / "room.toml"), "--runner", "inline", "-o", str(self.bases["room"])]) == 0
        assert main(["run", *drawn, "-o", str(self.bases["tube"])]) == 0
        words = ["import", "carmen", str(folder / "log.txt"), "--range-max", "60", "--map", str(folder / "room.yaml")]
        assert main([*words, "-o", str(self.bases["log"])]) == 0

    def craft(self, base: str, change: Change | None = None, files: dict[str, bytes] | None = None) -> Path:
        """Write a recording anew with another scenario or other files; every checksum is right."""
        source = read_recording(self.bases[base])
        raw = json.loads(source.header.scenario)
        if change is not None:
            change(raw)
        header = msgspec.structs.replace(source.header, scenario=json.dumps(raw))
        attachments = source.attachments
        if files is not None:
            attachments = tuple(
                Attachment(name=FOLDER + name, media_type="image/png", data=data) for name, data in files.items()
            )
        self._count += 1
        path = self.folder / f"crafted-{self._count}.mcap"
        with RecordingWriter(path, header, attachments, boot="recorder") as writer:
            for one in source.records:
                envelope = Envelope(one.node, one.boot, one.sequence, 0, one.stamp_ns, one.publish_ns)
                writer.message(one.topic, envelope, one.payload)
            writer.close(complete=True, reason="finished")
        return path

    def out(self) -> Path:
        self._count += 1
        return self.folder / f"out-{self._count}.mcap"

    def words(self, commands: Iterable[tuple[str, ...]], path: Path, base: str) -> list[list[str]]:
        return [[word.format(path, base=self.bases[base], out=self.out()) for word in words] for words in commands]

    def run(self, commands: list[list[str]]) -> list[Told]:
        """Run the commands in one process whose current folder, and whose Python path, this folder is."""
        self.mark.unlink(missing_ok=True)
        done = subprocess.run(
            [sys.executable, "-P", audited.__file__],
            input=json.dumps(commands),
            capture_output=True,
            text=True,
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(self.folder))), "TMPDIR": str(self.own)},
            timeout=240,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return [
            Told(
                one["words"],
                one["code"],
                one["out"],
                one["err"],
                frozenset(one["imported"]),
                frozenset(one.get("opened", ())),
                tuple(one.get("started", ())),
            )
            for one in json.loads(done.stdout)
        ]

    def harmless(self, told: Iterable[Told]) -> None:
        """Fail where a command imported, opened or started what a stranger wishes, or did not end in words."""
        strange = {"evil", "evil_pack", "evil_pack.models", "evil_pack.models.deep", "this", "antigravity"}
        for one in told:
            assert one.code in {0, 1, 2}, one
            assert "Traceback" not in one.err, one
            assert not one.imported & strange, one
            assert not one.started, one
            mine = {str(self.folder / word) for word in one.words}
            pages = {Path(name).with_suffix(".html") for name in mine if name.endswith(".mcap")}
            mine |= {f"{name}.sig" for name in mine} | {*map(str, pages)}  # a file's signature and page lie beside it
            drafts = tuple(f"{page.parent}/.{page.name}." for page in pages)
            others = {name for name in one.opened if name not in mine and not name.startswith(drafts)}
            others = {name for name in others if not self._belongs_to_dynpf(name)}
            assert not others, (one.words, others)
        assert not self.mark.exists()

    def _belongs_to_dynpf(self, name: str) -> bool:
        """Return whether a file is of the program, of Python and its packages, or a temporary one of its own."""
        roots = (str(ROOT), sys.prefix, sys.base_prefix, str(self.own))
        return any(name.startswith(f"{root}/") for root in roots) or name == "/proc/cpuinfo"


@pytest.fixture(name="lab", scope="module")
def make_lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return Lab(tmp_path_factory.mktemp("lab"))


def motion(kind: object) -> Change:
    return lambda raw: raw["estimator"].update(motion={"kind": kind, "args": ["touch", "MARK"]})


def section(name: str, *, bare: bool) -> Change:
    one: object = "evil:Model" if bare else {"kind": "evil:Model"}
    listed = name in {"measurement", "adaptation"} and not bare
    return lambda raw: raw["estimator"].update({name: [one] if listed else one})


def elsewhere(*keys: str) -> Change:
    """Put the class where no class may stand."""

    def change(raw: Raw) -> None:
        table: Any = raw
        for key in keys[:-1]:
            table = table[key]
        table[keys[-1]] = {"kind": "evil:Model"} if len(keys) == 1 else "evil:Model"

    return change


def promised(raw: Raw) -> None:
    """Say that the module has been looked up already."""
    raw["user_code"] = {"evil": "0" * 64, "kind": "package.module:Name"}
    raw["estimator"]["motion"] = {"kind": "evil:Model"}


def promised_reading(raw: Raw) -> None:
    """Name a model whose readings the graph of the run depends on, and say that it has been looked up already."""
    raw["user_code"] = {"evil": "0" * 64}
    raw["estimator"]["measurement"] = [{"kind": "evil:Model"}]


def promised_node(raw: Raw) -> None:
    """Name a node beside the others, and say that it has been looked up already."""
    raw["user_code"] = {"evil": "0" * 64}
    raw["nodes"] = [{"name": "spy", "kind": "evil:Model"}]


def replaced_node(raw: Raw) -> None:
    """Name a node in the place of one that the run had."""
    raw["user_code"] = {"evil": "0" * 64}
    raw["sensors"] = {"kind": "evil:Model"}


def posed(raw: Raw) -> None:
    """Pretend to be what such a table becomes inside."""
    parameters = {"kind": "evil:Model"}
    raw["estimator"]["motion"] = {"kind": "package.module:Name", "name": "evil:Model", "parameters": parameters}


def test_no_command_imports_or_starts_what_a_recording_names(lab: Lab) -> None:
    changes = [*map(motion, KINDS), motion(["evil:Model"]), motion({"kind": "evil:Model"}), promised, posed]
    changes += [promised_reading, promised_node, replaced_node]
    changes += [section(name, bare=bare) for name in SECTIONS for bare in (False, True)]
    places = [("estimator",), ("simulator", "kind"), ("controller", "kind"), ("sensors",), ("map",), ("task",)]
    places += [("estimator", "kind"), ("estimator", "start", "kind"), ("estimator", "health", "kind"), ("colon",)]
    changes += [elsewhere(*keys) for keys in places]
    crafted = [lab.craft("marks", change) for change in changes]
    replays = lab.run([words for path in crafted for words in lab.words(REPLAYS, path, "marks")])
    lab.harmless(replays)
    for one in replays:
        assert one.code in {1, 2}, one
        assert not one.out, one
    hidden = (promised_reading, promised_node, replaced_node)
    others = [
        lab.craft("marks", change) for change in (motion("evil:Model"), motion("subprocess:Popen"), posed, *hidden)
    ]
    lab.harmless(lab.run([words for path in others for words in lab.words(OTHERS, path, "marks")]))


def test_the_error_tells_the_key_the_class_the_module_and_the_option(lab: Lab) -> None:
    def change(raw: Raw) -> None:
        raw["estimator"] |= {"motion": {"kind": "evil:Model"}, "resampling": {"kind": "evil_pack.models:Other"}}

    path = lab.craft("marks", change)
    (told,) = lab.run([["replay", str(path)]])
    first, second = told.err.splitlines()
    for line, words in (
        (first, ("estimator.motion.kind", "class Model of the module evil,", "--allow-code evil")),
        (second, ("estimator.resampling.kind", "class Other of the module evil_pack.models,", "evil_pack.models")),
    ):
        assert str(path) in line
        assert all(word in line for word in words), line
        assert line.endswith(words[-1])


def test_the_reader_may_allow_a_module_by_its_name_and_no_other(lab: Lab) -> None:
    """The control: with the option the mark is left, and the hook sees the import, the file and the program."""
    allowed, package = lab.craft("marks", motion("evil:Model")), lab.craft("marks", motion("evil_pack.models:Model"))
    refused = [["--allow-code", name] for name in ("evi", "evil_pack.model", "evil_pack", "evil_pack.models.deep")]
    lab.harmless(lab.run([["replay", str(package), *words] for words in refused]))
    for path, module in ((allowed, "evil"), (package, "evil_pack.models")):
        (told,) = lab.run([["replay", str(path), "--allow-code", module]])
        assert lab.mark.exists()
        assert module in told.imported
        assert str(lab.mark) in told.opened
        assert "os.system" in told.started
        assert told.code == 1, told  # replayed, and not what was recorded
    plain = ["replay", str(lab.bases["marks"]), "--set", "estimator.motion={kind='evil:Model'}"]
    (told,) = lab.run([plain])
    lab.harmless([told])
    assert told.err.endswith("--allow-code evil\n")
    (told,) = lab.run([[*plain, "--allow-code", "evil"]])
    assert told.code == 1, told
    (told,) = lab.run([["replay", str(allowed), "--allow-code", "evil:Model"]])
    assert told.code == 2
    assert "'evil:Model': expected the name of a module, such as mylab.models" in told.err


def test_info_and_doctor_tell_what_a_replay_would_run(lab: Lab) -> None:
    path, plain = lab.craft("marks", motion("evil_pack.models:Model")), lab.bases["marks"]
    info, doctor = ([name, str(path)] for name in ("info", "doctor"))
    own = ["info", str(lab.craft("marks", motion("os:system")))]
    told = lab.run([info, [*info, "--json"], doctor, [*doctor, "--json"], ["doctor", str(plain), "--json"], own])
    lab.harmless(told)
    expected = [{"key": "estimator.motion.kind", "module": "evil_pack.models", "class": "Model"}]
    line = "estimator.motion.kind names the class Model of the module evil_pack.models"
    assert f"{line}, which replay runs only with --allow-code evil_pack.models" in told[0].out
    assert line in told[2].out
    assert "the class system of the module os, which replay refuses" in told[5].out
    assert [json.loads(told[place].out)["code"] for place in (1, 3)] == [expected, expected]
    assert not json.loads(told[3].out)["healthy"]  # the scenario is not that of the run
    nothing: dict[str, object] = {"findings": [], "code": [], "signed": None, "restarts": []}
    assert json.loads(told[4].out) == {"healthy": True, "resumable": False, **nothing}


def paths_of(lab: Lab) -> tuple[str, ...]:
    there = ("secret.png", "link.png", "fifo", "secret.yaml")
    return (
        *(str(lab.folder / name) for name in there),
        *there,
        *(f"../{lab.folder.name}/{name}" for name in there),
        *("/etc/passwd", "/dev/zero", "/dev/stdin", "/proc/self/environ", "~/secret.png", "file:secret.png"),
        *("", ".", "..", "/", "secret.png\0", "x" * 5000, "gone.png"),
    )


def with_those(**tables: object) -> Change:
    return lambda raw: raw.update(tables)


def test_no_command_opens_a_file_that_a_recording_names(lab: Lab) -> None:
    crafted: list[tuple[Path, str]] = []
    room = {one.name.removeprefix(FOLDER): one.data for one in read_recording(lab.bases["room"]).attachments}
    for path in paths_of(lab):
        for kind in ("bitmap", "occupancy"):
            table = {"kind": kind, "file": path}
            crafted += [(lab.craft("room", with_those(map=table)), "room")]
        yaml = {**room, "room.yaml": YAML.format(json.dumps(path)).encode()}
        crafted += [(lab.craft("room", files=yaml), "room")]
        crafted += [(lab.craft("tube", with_those(maps=[path, "own-b.png"])), "tube")]
    crafted += [(lab.craft("room", files={}), "room"), (lab.craft("tube", files={}), "tube")]
    named = {f"../{lab.folder.name}/secret.png": b"", str(lab.secret): b"", "secret.png": b""}
    crafted += [
        (lab.craft("room", lambda raw: raw.update(map={"kind": "bitmap", "file": "secret.png"}), named), "room")
    ]
    replays = [("replay", "{}"), ("replay", "{}", "--set", "estimator.n=9")]
    told = lab.run([words for path, base in crafted for words in lab.words(replays, path, base)])
    lab.harmless(told)
    for one in told:
        assert one.code == 2, one
        assert "secret.png" not in one.err or "map" in one.err, one
    some = [*crafted[:6], *crafted[-3:]]
    lab.harmless(lab.run([words for path, base in some for words in lab.words(OTHERS, path, base)]))
    # An override of something else, or of the kind, does not make the recording's path the reader's.
    hidden = lab.craft("room", lambda raw: raw.update(map={"kind": "occupancy", "file": str(lab.secret)}))
    (told_of,) = lab.run([["replay", str(hidden), "--set", "map.kind=bitmap"]])
    lab.harmless([told_of])
    assert f"map.file: '{lab.secret}' cannot be read: the recording has no such file attached" in told_of.err


def test_the_reader_may_name_a_file_of_his_own(lab: Lab) -> None:
    """The control: the hook sees the file that --set names, and the image that it names in turn."""
    words = ["replay", str(lab.bases["room"]), "--set"]
    own = "map={kind='bitmap', file='secret.png', resolution=0.1}"
    bitmap, yaml = lab.run([[*words, own], [*words, "map.file=secret.yaml"]])
    assert str(lab.secret) in bitmap.opened
    assert {str(lab.secret), str(lab.folder / "secret.yaml")} <= yaml.opened
    assert (bitmap.code, yaml.code) == (0, 0), (bitmap, yaml)  # the same walls, so the same run


def test_the_map_of_a_strangers_log_comes_from_the_log_alone(lab: Lab) -> None:
    image = cv2.imread(str(lab.secret), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    encoded = cv2.imencode(".png", image)[1].tobytes()
    crafted = [lab.craft("log", files={"m.yaml": YAML.format(json.dumps(path)).encode()}) for path in paths_of(lab)]
    for name in (f"../{lab.folder.name}/secret.yaml", str(lab.folder / "secret.yaml"), "sub/secret.yaml"):
        crafted += [lab.craft("log", files={name: YAML.format("secret.png").encode()})]
    words = ["run", str(lab.folder / "log.toml"), "--runner", "inline", "--log"]
    told = lab.run([[*words, str(path), "-o", str(lab.out())] for path in crafted])
    for one in told:
        assert one.code == 2, one
    lab.harmless([one._replace(words=[*one.words, "log.toml"]) for one in told])
    good = lab.craft("log", files={"m.yaml": YAML.format("secret.png").encode(), "secret.png": encoded})
    (whole,) = lab.run([[*words, str(good), "-o", str(lab.out())]])
    assert whole.code == 0, whole
    assert str(lab.secret) not in whole.opened


def test_the_references_run_the_code_of_their_table_and_no_other(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(lab.folder))
    lab.craft("marks", motion("evil:Model")).rename(lab.folder / "strange.mcap")
    made = Made(digest="", dynpf="")
    entry = Entry(name="strange", scenario="landmark-room", seed=1, nodes=("estimator",), why="", made=made)
    lab.mark.unlink(missing_ok=True)
    found = check_part(Table(lab.folder / "table.toml", (entry,)), entry, "estimator")
    assert found.verdict == "differs"
    assert "estimator.motion.kind: names the class Model of the module evil" in found.note
    assert not lab.mark.exists()
