"""Text from elsewhere neither controls a terminal nor begins a line of its own."""

import unicodedata

import pytest
from dynpf_protocol.printable import printable
from dynpf_runtime.bus.terminal import say
from hypothesis import given
from hypothesis import strategies as st


@given(text=st.text(max_size=60))
def test_it_has_no_control_characters_and_can_be_encoded(text: str) -> None:
    shown = printable(text)
    assert not {unicodedata.category(char) for char in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    shown.encode()


@given(text=st.text(st.characters(categories=["L", "N", "P", "S", "M"], include_characters=" "), max_size=60))
def test_ordinary_text_of_any_language_stays(text: str) -> None:
    assert printable(text) == text


def test_a_long_text_is_cut_and_its_length_said() -> None:
    assert printable("x" * 10_000, 10) == "xxxxxxxxxx... (10000 characters)"
    assert len(printable("\x1b" * 10_000)) < 600


def test_a_notice_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("recorder", "dynpf/data/\x1b[2J\x1b]0;title\x07: refused\r\nrun.mcap is complete")
    assert capsys.readouterr().err == (
        "dynpf recorder: dynpf/data/\\x1b[2J\\x1b]0;title\\x07: refused\\r\\nrun.mcap is complete\n"
    )
