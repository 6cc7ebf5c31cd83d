"""A case: one hostile input, made by its number alone, and the trials that it is given to."""

import bz2
import gzip
import lzma
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import NamedTuple

from dynpf_formats.recording.errors import RecordingError
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.play import envelope_of, played_messages
from dynpf_protocol.envelope import encode_envelope
from dynpf_services.scenario.build import plan_of
from dynpf_services.scenario.load import load_scenario
from dynpf_services.scenario.played_log import PlayedLog
from mcap.records import Message

from checks.edits.content import read_content, resealed, write_content
from checks.fuzz.anatomy import Anatomy
from checks.fuzz.captures import mended
from checks.fuzz.credentials import keys_trials, signature_action
from checks.fuzz.edits import edited
from checks.fuzz.sources import Sources
from checks.fuzz.subjects import command, difference, quiet, recovered
from checks.fuzz.trial import LIMITS, Limits
from checks.fuzz.values import Values, torn

__all__ = ["FILES", "Trial", "files_case"]

_COMPRESSED: tuple[tuple[str, Callable[[bytes], bytes]], ...] = (
    (".gz", gzip.compress),
    (".xz", partial(lzma.compress, preset=0)),
    (".bz2", bz2.compress),
)
_SPECIAL = ("/dev/zero", "/dev/full", "/proc/self/mem", "fifo", ".", "missing.yaml", "n" * 300, "", "\0", "/dev/tty")
_RESEALED = 0.2  # of the recordings
_REPLAYED_AT_MOST = 500_000
"""Bytes of a file that is replayed, too: what a run computes is not bounded by what reading is."""
_TRIALS_A_RECORDING = 3
_FORMS = (["--format", "csv"], ["--format", "tum"])
_TOPICS: tuple[list[str], ...] = ([], ["--topic", "sensors/scan"], ["--topic", "estimator/state"])


EXECUTED = Limits(seconds=10.0, bytes=2**30)
"""What a replay may take: it builds the maps of a run, which have a limit of their own, of 2e8 cells."""


class Trial(NamedTuple):
    """An action on the input; ``subject`` names what is tried."""

    subject: str
    action: Callable[[], object]
    limits: Limits = LIMITS


class Workshop(NamedTuple):
    """What cases are made of: the sound files, a folder for hostile ones, and those that showed something new."""

    sources: Sources
    folder: Path
    corpus: tuple[Path, ...] = ()


def files_case(number: int, seed: int, workshop: Workshop) -> Iterator[Trial]:
    """Yield the trials of a case; the file exists until the last is done."""
    random = Random(f"{seed}/{number}")
    kind = random.choices([*FILES], [weight for weight, _ in FILES.values()])[0]
    yield from FILES[kind][1](random, workshop)


def _recording(random: Random, workshop: Workshop) -> Iterator[Trial]:
    sound, data = _hostile_recording(random, workshop)
    path = workshop.folder / random.choices(("hostile.mcap", os.fsdecode(b"h\xff.mcap")), (99, 1))[0]
    path.write_bytes(data)
    if random.random() < _RESEALED:
        _reseal(path)
    names = [name for name in RECORDING_TRIALS if name != "replay" or len(data) < _REPLAYED_AT_MOST]
    for name in random.sample(names, _TRIALS_A_RECORDING):
        yield RECORDING_TRIALS[name](random, workshop, sound, path)
    path.unlink()


def _command(
    name: str, *choices: Sequence[str], limits: Limits = LIMITS
) -> Callable[[Random, Workshop, Path, Path], Trial]:
    """Return the maker of the trial of a command, with one of some further arguments."""
    return lambda random, _workshop, _sound, path: Trial(
        name, partial(command, name, path, *random.choice(choices)), limits
    )


def _hostile_recording(random: Random, workshop: Workshop) -> tuple[Path, bytes]:
    sound = random.choice([*workshop.sources.recordings.values()])
    if workshop.corpus and random.random() < 0.3:
        data = random.choice(workshop.corpus).read_bytes()
        return sound, torn(data, random) if random.random() < 0.3 else edited(_taken_apart(data, sound), random)
    data = sound.read_bytes()
    return sound, torn(data, random) if random.random() < 0.1 else edited(_parts(sound), random)


@cache
def _parts(sound: Path) -> Anatomy:
    return Anatomy.of(sound.read_bytes())


def _reseal(path: Path) -> None:
    """Make chain and seal of a file right, if it can be read: then it is executed as if nobody had changed it."""
    try:
        write_content(resealed(read_content(path)), path)
    except (RecordingError, UnicodeError):
        return


def _taken_apart(data: bytes, sound: Path) -> Anatomy:
    """Return the parts of a file of the corpus, or, where it does not come apart, of the sound one."""
    try:
        return Anatomy.of(data)
    except ValueError:
        return _parts(sound)


def _text(kind: str, text: Callable[[Sources], str], random: Random, workshop: Workshop) -> Iterator[Trial]:
    data = _changed_text(text(workshop.sources), random)
    suffix, pack = random.choices((("", bytes), *_COMPRESSED), (8, 1, 1, 1))[0]
    path = workshop.folder / f"hostile.{kind}{suffix}"
    packed = pack(data)
    path.write_bytes(torn(packed, random) if random.random() < 0.1 else packed)
    more = random.choice(([], ["--map-from-poses", "0.2"])) if kind == "carmen" else []
    yield Trial(f"import {kind}", lambda: _imported(workshop, kind, path, *more))
    path.unlink()


def _changed_text(text: str, random: Random) -> bytes:
    """Change words or lines of a text, or tear its bytes."""
    values, lines = Values(random), text.splitlines()
    for _ in range(random.choice((1, 1, 2, 5))):
        place = random.randrange(len(lines)) if lines else 0
        match random.choice(("word", "word", "word", "drop", "repeat", "exchange", "long", "cut")):
            case "word" if lines and (words := lines[place].split(" ")):
                words[random.randrange(len(words))] = random.choice((str(values.number()), values.text(), "1e400", "-"))
                lines[place] = " ".join(words)
            case "drop":
                del lines[place : place + 1]
            case "repeat":
                lines[place:place] = lines[place : place + 1] * random.choice((2, 1000))
            case "exchange":
                random.shuffle(lines)
            case "long" if lines:
                lines[place] += " 1" * random.choice((1000, 200_000))
            case "cut":
                del lines[place:]
    data = "\n".join(lines).encode(errors="surrogatepass")
    return torn(data, random) if random.random() < 0.2 else data


def _mrclam(random: Random, workshop: Workshop) -> Iterator[Trial]:
    folder = workshop.folder / "mrclam"
    folder.mkdir(exist_ok=True)
    chosen = random.choice([*workshop.sources.mrclam])
    for name, text in workshop.sources.mrclam.items():
        data = _changed_text(text, random) if name == chosen else text.encode()
        if random.random() < 0.2:
            (folder / f"{name}.xz").write_bytes(lzma.compress(data, preset=0))
        else:
            (folder / name).write_bytes(data)
    words = random.choice((["--robot", "1"], ["--robot", "all"], ["--robot", "1", "--robots"]))
    yield Trial("import mrclam", lambda: _imported(workshop, "mrclam", folder, *words))
    for path in folder.iterdir():
        path.unlink()


def _map(random: Random, workshop: Workshop) -> Iterator[Trial]:
    folder = workshop.folder
    image = random.choice(("map.pgm", "map.png"))
    text = workshop.sources.map["map.yaml"].decode().replace("map.pgm", image)
    pixels = workshop.sources.map[image]
    if random.random() < 0.5:
        text = _changed_text(text, random).decode(errors="replace")
    else:
        pixels = _changed_image(pixels, random)
    if random.random() < 0.05:
        text = text.replace(image, _special(random, folder))
    (folder / "hostile.yaml").write_text(text, errors="replace")
    (folder / image).write_bytes(pixels)
    yield Trial("import map", lambda: _imported(workshop, "map", folder / "hostile.yaml"))


def _special(random: Random, folder: Path) -> str:
    name = random.choice(_SPECIAL)
    if name == "fifo" and not (folder / name).exists():
        os.mkfifo(folder / name)
    return name


def _changed_image(data: bytes, random: Random) -> bytes:
    if data.startswith(b"P5") and random.random() < 0.6:
        head, _, rest = data.partition(b"255\n")
        del head
        width, height = (random.choice((0, 1, 40, 3000, 40_000, 2**31, 10**20)) for _ in range(2))
        return f"P5\n{width} {height}\n{random.choice((255, 0, 65_535, 10**9))}\n".encode() + rest
    return torn(data, random)


def _bag(random: Random, workshop: Workshop) -> Iterator[Trial]:
    kind = random.choice([*workshop.sources.bags])
    data = workshop.sources.bags[kind].read_bytes()
    path = workshop.folder / f"hostile.{kind}"
    if kind == "db3":
        path.write_bytes(data)
        _change_database(path, random)
        if random.random() < 0.3:
            path.write_bytes(torn(path.read_bytes(), random))
    elif kind == "mcap" and random.random() < 0.7:
        path.write_bytes(_changed_bag(data, random))
    else:
        path.write_bytes(torn(data, random))
    words = random.choice(([], [], ["--scan", "/points"], ["--odometry", "tf"]))
    yield Trial(f"import bag {kind}", lambda: _imported(workshop, "rosbag", path, *words))
    path.unlink()


def _capture(random: Random, workshop: Workshop) -> Iterator[Trial]:
    data = workshop.sources.capture.read_bytes()
    path = workshop.folder / "hostile.mcap"
    path.write_bytes(torn(data, random) if random.random() < 0.2 else edited(Anatomy.of(data), random))
    words = random.choice(([], ["--json"]))
    yield Trial("doctor of a capture", lambda: command("doctor", path, *words))
    yield Trial("info of a capture", lambda: command("info", path, *words))
    yield Trial("recover a capture", lambda: mended(path, workshop.folder / "mended.mcap"))
    path.unlink()


def _changed_bag(data: bytes, random: Random) -> bytes:
    """Change the payloads of a ROS 2 bag in MCAP, or its structure as that of a recording."""
    anatomy = Anatomy.of(data)
    messages = [message for message in anatomy.of_type(Message) if message.data]
    if random.random() < 0.5 and messages:
        for message in random.sample(messages, min(len(messages), random.choice((1, 3, 10)))):
            message.data = torn(message.data, random)
        return anatomy.bytes()
    return edited(anatomy, random)


def _change_database(path: Path, random: Random) -> None:
    with sqlite3.connect(path) as database:
        rows = database.execute("select id, data from messages").fetchall()
        for identity, data in random.sample(rows, random.choice((1, 3, 10))):
            values = (torn(bytes(data), random), identity)
            database.execute("update messages set data = ? where id = ?", values)
        if random.random() < 0.3:
            text = random.choice(("", "x" * 1000, "sensor_msgs/msg/LaserScan", "a/b", "float64 x\n" * 1000))
            column = random.choice(("type", "name", "serialization_format"))
            database.execute(f"update topics set {column} = ?", (text,))
    database.close()


def _scenario(random: Random, workshop: Workshop) -> Iterator[Trial]:
    folder = workshop.folder
    text = random.choice([*workshop.sources.scenarios.values()])
    data = _changed_toml(text, random)
    if random.random() < 0.05:
        data += f'\n[map]\nkind = "occupancy"\nfile = {_quoted(_special(random, folder))}\n'.encode()
    if random.random() < 0.1:
        data = data.replace(b"map.yaml", _special(random, folder).encode())
    path = folder / "hostile.toml"
    path.write_bytes(torn(data, random) if random.random() < 0.1 else data)
    (folder / "map.yaml").write_bytes(workshop.sources.map["map.yaml"])
    (folder / "map.pgm").write_bytes(workshop.sources.map["map.pgm"])
    overrides = [random.choice(("a=1", "estimator.n=1e9", "map.file=/dev/zero", "seed=nan", "nodes.0.n=[[[", "x"))]
    yield Trial("scenario", lambda: _built(path, overrides if random.random() < 0.1 else []))
    path.unlink()


def _quoted(text: str) -> str:
    return '"' + text.replace("\0", "\\u0000") + '"'


def _changed_toml(text: str, random: Random) -> bytes:
    """Change values, keys and lines of a scenario file."""
    values, lines = Values(random), text.splitlines()
    for _ in range(random.choice((1, 1, 2, 4))):
        place = random.randrange(len(lines))
        key, equals, _ = lines[place].partition("=")
        match random.choice(("value", "value", "value", "key", "drop", "repeat", "number")):
            case "value" if equals:
                lines[place] = f"{key}= {_toml(values)}"
            case "number" if equals:
                lines[place] = f"{key}= {random.choice((0, -1, 1e300, 'inf', 'nan', 10**9, 10**18, 2**63, 1e-300))}"
            case "key" if equals:
                lines[place] = lines[place].replace(key.strip(), random.choice(("kind", "n", "é", "nodes", "seed")), 1)
            case "drop":
                del lines[place]
            case "repeat":
                lines.insert(random.randrange(len(lines)), lines[place])
        if not lines:
            break
    return "\n".join(lines).encode(errors="surrogatepass")


def _toml(values: Values) -> str:
    deep = "[" * 100_000 + "]" * 100_000
    return values.random.choice(
        (
            *('""', "true", "[]", "{}", "[[]]", "inf", "nan", "1e400", "-1", "0", str(10**400), "{ a = { b = 1 } }"),
            *('"subprocess:Popen"', '{ kind = "this:X" }', '"' + "x" * 10_000 + '"', "[" + "1, " * 10_000 + "]"),
            *(deep if values.random.random() < 0.1 else "[[[[]]]]", "1979-05-27", str(values.number())),
        )
    )


def _built(path: Path, overrides: list[str]) -> None:
    """Load a scenario and build its nodes, as ``dynpf run`` does before it starts any process."""
    with quiet():
        for spec in plan_of(load_scenario(str(path), overrides=overrides)).graph.specs.values():
            spec.build()


def _played(path: Path) -> None:
    """Read as ``dynpf play`` does, without a bus."""
    recording = read_recording(path)
    for record in played_messages(recording):
        encode_envelope(envelope_of(recording, record, 0))


def _imported(workshop: Workshop, form: str, source: Path, *words: str) -> None:
    _written("import", workshop.folder / "imported.mcap", form, source, *words)


def _written(name: str, output: Path, *words: str | Path) -> None:
    try:
        command(name, *words, "-o", output)
    finally:
        output.unlink(missing_ok=True)


def _keys(random: Random, workshop: Workshop) -> Iterator[Trial]:
    for name, action in keys_trials(random, workshop.sources.keys, workshop.sources.recordings["log"], workshop.folder):
        yield Trial(name, action)


Maker = Callable[[Random, Workshop], Iterator[Trial]]

RECORDING_TRIALS: Mapping[str, Callable[[Random, Workshop, Path, Path], Trial]] = {
    "doctor": _command("doctor", [], ["--json"]),
    "info": _command("info", [], ["--json"]),
    "metrics": _command("metrics", []),
    "fit": _command("fit", []),
    "replay": _command("replay", [], limits=EXECUTED),
    "export": _command("export", *([*form, *topic] for form in _FORMS for topic in _TOPICS)),
    "parquet": lambda _random, workshop, _sound, path: Trial(
        "parquet", lambda: _written("export", workshop.folder / "p", path, "--format", "parquet")
    ),
    "view": lambda _random, workshop, _sound, path: Trial(
        "view", lambda: _written("view", workshop.folder / "page.html", path, "--no-open")
    ),
    "recover": lambda _random, workshop, _sound, path: Trial(
        "recover", lambda: recovered(path, workshop.folder / "recovered.mcap")
    ),
    "diff": lambda _random, _workshop, sound, path: Trial("diff", lambda: difference(sound, path)),
    "play": lambda _random, _workshop, _sound, path: Trial("play", lambda: _played(path)),
    "log of a run": lambda _random, _workshop, _sound, path: Trial("log of a run", lambda: PlayedLog(path)),
    "signature": lambda random, workshop, _sound, path: Trial(
        "signature", signature_action(random, workshop.sources.keys, path)
    ),
}
"""What a hostile recording is given to; a case draws some of them."""

FILES: Mapping[str, tuple[int, Maker]] = {
    "recording": (50, _recording),
    "keys": (5, _keys),
    "tum": (7, partial(_text, "tum", lambda sources: sources.tum)),
    "carmen": (8, partial(_text, "carmen", lambda sources: sources.carmen)),
    "mrclam": (7, _mrclam),
    "map": (8, _map),
    "bag": (6, _bag),
    "capture": (4, _capture),
    "scenario": (10, _scenario),
}
"""The kinds of files, each with its share of the cases."""
