"""The page as a file: the same bytes each time, its scripts those that its policy allows, and text never markup."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from dynpf_experiments.pictures.event import Event
from dynpf_experiments.pictures.figures import figures
from dynpf_experiments.pictures.page import Apart, RunPicture
from dynpf_formats.recording.reader import read_recording
from dynpf_lab.cli.main import main
from dynpf_lab.page import making
from dynpf_lab.page.bundle import bundled
from dynpf_lab.page.document import document
from dynpf_lab.page.making import MOST_BYTES, make_page, page_of
from dynpf_protocol.errors import UsageError

from tests.unit.page.runs import picture, recorded, short_run

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(1)>\"'`{{}}--><!--\u202e\u0000"
VENDOR = Path(making.__file__).parent / "vendor"


class Seen(HTMLParser):
    """The tags of a page, the texts of its scripts, and attributes that would be code."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.scripts: list[str] = []
        self.code: list[str] = []
        self.within = False  # a script
        self.policy = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.code += [name for name, _ in attrs if name.startswith("on") or name == "style"]
        self.within = tag == "script"
        if self.within:
            self.scripts.append("")
        if dict(attrs).get("http-equiv") == "Content-Security-Policy":
            self.policy = str(dict(attrs)["content"])

    def handle_endtag(self, tag: str) -> None:
        self.within = self.within and tag != "script"

    def handle_data(self, data: str) -> None:
        if self.within:
            self.scripts[-1] += data


def evil(value: Any) -> Any:
    """Return the same with every text replaced by one that would do harm."""
    match value:
        case str():
            return EVIL
        case dict():
            return {key: evil(each) for key, each in value.items()}
        case tuple() if hasattr(value, "_fields"):
            return type(value)(*map(evil, value))
        case list() | tuple():
            return type(value)(map(evil, value))
    return value


def test_text_from_a_recording_is_never_markup() -> None:
    honest = picture(recorded("faults"))
    harmless = Seen(document([honest], None, "mark"))
    data = {**honest.data, "events": evil(honest.data["events"]), "health": evil(honest.data["health"])}
    events = [evil(event)._replace(kind=event.kind) for event in honest.events]
    hostile = RunPicture(*map(evil, honest))._replace(events=events, data=data)
    found = Seen(document([hostile], None, "mark"))
    assert found.tags == harmless.tags
    assert found.code == []
    assert found.scripts[1:] == harmless.scripts[1:]
    assert json.loads(found.scripts[0])["runs"][0]["events"][0][-1] == EVIL
    assert "<img src=x" not in document([hostile], Apart(False, EVIL, 3, [(EVIL, 1, 2, 3)], [(EVIL,) * 3]), "mark")


def test_the_policy_allows_the_scripts_of_the_page_and_nothing_else() -> None:
    found = Seen(document([picture(recorded("colon"))], None, "mark"))
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in found.scripts[1:]]
    assert re.findall(r"'sha256-([^']+)'", found.policy.partition("script-src")[2]) == hashes
    assert found.policy.startswith("default-src 'none';")
    assert "unsafe" not in found.policy
    assert "http" not in re.sub(r"http://www\.w3\.org/2000/svg", "", found.scripts[2])


def test_a_number_that_is_not_finite_is_no_page() -> None:
    shown = picture(recorded("colon"))
    with pytest.raises(ValueError, match="Out of range"):
        document([shown._replace(data={**shown.data, "seconds": float("nan")})], None, "mark")


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    pages = []
    for name in ("a", "b"):
        path = tmp_path / name / "run.mcap"
        path.parent.mkdir()
        path.write_bytes(short_run("landmark-room", 60).path.read_bytes())
        assert make_page([read_recording(path)], page_of(path))
        pages.append(page_of(path).read_bytes())
    assert pages[0] == pages[1]


def test_a_page_is_made_once_and_anew_where_the_recording_is_another(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert make_page([recorded("colon")], page)
    assert not make_page([recorded("colon")], page)
    assert make_page([recorded("faults")], page)
    assert "INCOMPLETE" not in page.read_text("utf-8")


def test_a_file_of_the_users_is_never_overwritten(tmp_path: Path) -> None:
    page = tmp_path / "notes.html"
    page.write_text("<!doctype html>\n<p>mine</p>\n")
    with pytest.raises(UsageError, match="is no page of dynpf's"):
        make_page([recorded("colon")], page)
    assert "mine" in page.read_text()
    assert [*tmp_path.iterdir()] == [page]


def test_a_page_is_at_most_two_megabytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.html"
    make_page([recorded("camera")], page)
    whole = page.stat().st_size
    assert whole <= MOST_BYTES
    page.unlink()
    monkeypatch.setattr(making, "MOST_BYTES", whole - 1000)
    make_page([recorded("camera")], page)
    assert page.stat().st_size <= whole - 1000


def test_a_run_leaves_a_page_and_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run.mcap"
    words = ["run", "landmark-room", "--set", "max_ticks=5", "--runner", "inline"]
    assert main([*words, "-o", str(run)]) == 0
    assert f"page        {tmp_path / 'run.html'}" in capsys.readouterr().out
    assert main([*words, "-o", str(tmp_path / "bare.mcap"), "--no-page"]) == 0
    assert "\npage " not in capsys.readouterr().out
    again = tmp_path / "again.mcap"
    assert main(["replay", str(run), "-o", str(again)]) == 0
    assert main(["view", str(run), str(again), "--no-open"]) == 0
    names = {path.name for path in tmp_path.glob("*.html")}
    assert names == {"run.html", "again.html", "run-and-again.html"}
    assert "none: both have the same content" in (tmp_path / "run-and-again.html").read_text("utf-8")


def test_a_page_that_cannot_be_made_fails_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.html").mkdir()
    words = ["run", "landmark-room", "--set", "max_ticks=5", "--runner", "inline", "-o", str(tmp_path / "run.mcap")]
    assert main(words) == 0
    told = capsys.readouterr()
    assert told.err.count("no page:") == 1
    assert "complete: finished" in told.out


def test_measures_are_told_with_units_and_intervals() -> None:
    rows = figures(
        {"heading_rmse_rad": 0.01, "nees_mean": 3.0, "nees_low": 2.5, "nees_high": 3.5, "lost_fraction": 0.5}
    )
    assert [(row.label, row.value, row.unit, row.interval) for row in rows] == [
        ("Heading RMSE", "0.573", "deg", ""),
        ("NEES mean", "3", "", "2.5 to 3.5"),
        ("Lost", "50", "%", ""),
    ]


def test_modules_keep_to_themselves_and_come_in_order() -> None:
    modules = {
        "main": 'import { twice } from "./other.mjs";\n\nconst own = twice(2);\nexport const told = () => own;',
        "other": "const own = 2;\nexport function twice(a) {\n  return own * a;\n}",
    }
    script = bundled(modules, "main")
    assert script.index("module_other =") < script.index("module_main =")
    assert "export" not in script
    assert "const { twice } = module_other;" in script


@pytest.mark.parametrize(
    ("modules", "expected"),
    [
        ({"main": 'import { a } from "./b.mjs";', "b": 'import { c } from "./main.mjs";'}, "does not export"),
        (
            {
                "main": 'import { a } from "./b.mjs";\nexport const c = 1;',
                "b": 'import { c } from "./main.mjs";\nexport const a = 1;',
            },
            "circle",
        ),
        ({"main": "export default 3;"}, "neither a plain import"),
        ({"main": 'import all from "elsewhere";'}, "neither a plain import"),
    ],
)
def test_modules_of_another_form_are_refused(modules: dict[str, str], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        bundled(modules, "main")


def test_what_is_vendored_is_what_the_registry_has() -> None:
    told = dict(re.findall(r"`([\w.-]+)`[^|]*\| ([0-9a-f]{64})", (VENDOR / "README.md").read_text("utf-8")))
    for name in ("uPlot.iife.min.js", "uPlot.min.css"):
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == told[name]


def test_events_are_told_in_order() -> None:
    shown = picture(recorded("faults"))
    stamps = [event.seconds for event in shown.events]
    assert stamps == sorted(stamps)
    assert all(isinstance(event, Event) for event in shown.events)
