"""Whom a router refuses is told once a kind, and rarely again."""

from dynpf_runtime.bus.refused import Refused


def test_a_flood_of_refusals_is_told_in_a_few_lines() -> None:
    told: list[str] = []
    refused = Refused(told.append)
    for _ in range(12345):
        refused.connection("it showed no certificate")
    refused.connection("its certificate has expired")
    assert told == [
        "a connection was refused: it showed no certificate",
        *(f"{count} connections were refused: it showed no certificate" for count in (10, 100, 1000, 10000)),
        "a connection was refused: its certificate has expired",
    ]


def test_a_name_without_a_part_in_the_run_is_told_without_control_characters_and_known_ones_are_not() -> None:
    told: list[str] = []
    linked = Refused(told.append).watch_names({"vision"})
    linked("vision", "tls/127.0.0.1:1")
    assert told == []
    linked("mallory\x1b[2J", "tls/127.0.0.1:2")
    linked("mallory\x1b[2J", "tls/127.0.0.1:3")
    assert len(told) == 1
    assert "tls/127.0.0.1:2 has a certificate of the name 'mallory\\x1b[2J'" in told[0]
    assert told[0].isprintable()
