"""Options that several commands share: the scenario, its overrides, and the log that it plays."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from services.errors import UsageError
from services.scenario import LogFacts, Scenario, load_scenario

if TYPE_CHECKING:
    from services.recording.header import Attachment
    from services.source import LogRecord

__all__ = ["Log", "add_scenario_options", "load_log", "scenario_from"]

LANDMARKS = "landmarks.json"


class Log:
    """An imported log: its records, what it brings to a scenario, and what is attached to it."""

    def __init__(self, path: Path) -> None:
        from protocol.codec import decode
        from protocol.messages import RobotState
        from protocol.topics import topic
        from services.recording.digest import content_digest
        from services.recording.reader import read_recording
        from services.runners.replay import log_records

        recording = read_recording(path)
        self.path = path
        self.records: list[LogRecord] = log_records(recording)
        if not any(topic(one.topic).triggers for one in self.records):
            raise UsageError(f"{path}: holds no sensor records of an imported log; dynpf import makes such a recording")
        self.attachments: tuple[Attachment, ...] = recording.attachments
        found = [one.data for one in recording.attachments if one.name == LANDMARKS]
        reference = next((decode("log/truth", one.payload) for one in self.records if one.topic == "log/truth"), None)
        start = (reference.x, reference.y, reference.theta) if isinstance(reference, RobotState) else None
        self.facts = LogFacts(content_digest(recording), json.loads(found[0]) if found else [], start)


def add_scenario_options(parser: argparse.ArgumentParser) -> None:
    """Add SCENARIO, --seed, --set and --log."""
    parser.add_argument("scenario", metavar="SCENARIO", help="name (dynpf list) or TOML file")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of everything random in the run")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="override one key of the scenario, such as estimator.n=500; may be repeated",
    )
    parser.add_argument("--log", type=Path, metavar="IN.mcap", help="imported log that the sensors process plays")


def load_log(options: argparse.Namespace) -> Log | None:
    """Return the log named on the command line, or None."""
    return Log(options.log) if options.log is not None else None


def scenario_from(options: argparse.Namespace, log: Log | None) -> Scenario:
    """Return the resolved scenario that the command line describes; raises ScenarioError."""
    return load_scenario(
        options.scenario,
        overrides=options.overrides,
        seed=options.seed,
        clock=getattr(options, "clock", None),
        log=log.facts if log else None,
    )
