"""``dynpf service``: a single process of a run."""

import argparse
import socket
import time
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from dynpf_protocol.errors import BrokenOffError, RunError, UsageError

from dynpf_lab.cli.access import credentials_of, endpoint_of
from dynpf_lab.cli.arguments import SPEED, add_clock, add_connect, add_durable, add_keys, speed
from dynpf_lab.cli.options import add_scenario_options, load_log, scenario_from
from dynpf_lab.cli.sign import add_sign, check_key, sign_recording

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from dynpf_runtime.bus.session import Bus
    from dynpf_runtime.plan import Plan
    from dynpf_services.ros2.bridge import LiveRobot

__all__ = ["PATIENCE_S", "add_arguments", "recorder_output"]

PATIENCE_S = 30.0
_LONGEST_S = 86_400.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf service``."""
    parser.add_argument("name", metavar="NAME", help="router, recorder, or a node of the scenario")
    add_scenario_options(parser)
    add_clock(parser)
    add_connect(parser)
    add_connect(parser, "--listen", text="router: where to listen")
    add_keys(parser)
    parser.add_argument("--player", action="store_true", help="router: let dynpf play speak in the name of all nodes")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="RUN.mcap",
        help="recorder: the recording to write; {host} in it is this machine's name, which a container that is started "
        "again keeps, and a number follows if the file there is of an earlier run",
    )
    add_durable(parser)
    parser.add_argument(
        "--resume",
        action="store_true",
        help="recorder: go on with the run of the recording there, which was stopped, or whose processes are all gone",
    )
    add_sign(parser)
    parser.add_argument(
        "--patience",
        type=_seconds,
        default=PATIENCE_S,
        metavar="S",
        help="how long to wait for a process that is gone to be started again (default: %(default)g)",
    )
    parser.add_argument("--speed", type=speed, metavar="X", help=f"source: {SPEED}")
    parser.add_argument("--quiet", action="store_true", help="print only errors of this process itself")
    parser.add_argument("--parent", type=int, help=argparse.SUPPRESS)  # end when this process is gone
    parser.add_argument("--pulse", type=Path, help=argparse.SUPPRESS)  # the file by which it watches this one
    parser.add_argument("--robot", type=Path, help=argparse.SUPPRESS)  # the settings of a bridge to a live robot
    parser.set_defaults(run=run)


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0 <= seconds <= _LONGEST_S:
        raise argparse.ArgumentTypeError(f"{text} s; expected 0 to {_LONGEST_S:g}")
    return seconds


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf service`` and return its exit code."""
    try:
        return _run(options)
    except BrokenOffError as error:
        if options.quiet:  # the starting process knows the reason
            return error.exit_code
        raise RunError(str(error)) from error
    except KeyboardInterrupt:
        if options.quiet:
            return 1
        raise


def _check_options(options: argparse.Namespace) -> None:
    """Raise UsageError for an option that does nothing in this process."""
    name = options.name
    for option, wanted, whom in (
        ("--listen", name == "router", "for the router alone; other processes have --connect"),
        ("--connect", name != "router", "for all but the router, which has --listen"),
        ("--output", name == "recorder", "for the recorder alone"),
        ("--sign", name == "recorder", "for the recorder alone"),
    ):
        value = getattr(options, option[2:])
        if value is not None and not wanted:
            raise UsageError(f"{option} {value}: {name} has no use for it; it is {whom}")
    for option, given, wanted in (
        ("--player", options.player, "router"),
        ("--durable", options.durable, "recorder"),
        ("--resume", options.resume, "recorder"),
    ):
        if given and name != wanted:
            raise UsageError(f"{option}: {name} has no use for it; it is for the {wanted} alone")
    if options.resume and options.output is None:
        raise UsageError("--resume: name the recording with -o RUN.mcap")


def recorder_output(options: argparse.Namespace, seed: int) -> Path:
    """Return the path of the recording; one with {host} has a number if the file there is of an earlier run."""
    from dynpf_lab.cli.run import default_output

    if options.output is None:
        return default_output(Path(options.scenario).stem, seed)
    named = Path(str(options.output).replace("{host}", socket.gethostname()))
    path, number = named, 2
    while named != options.output and _is_of_earlier_run(path, options.patience):
        path, number = named.with_name(f"{named.stem}-{number}{named.suffix}"), number + 1
    return path


def _is_of_earlier_run(path: Path, patience_s: float) -> bool:
    """Return whether nobody waits for the recorder of a file any more.

    Its run has broken off, or it was written last before the longest time that the others wait.
    """
    from dynpf_formats.recording.errors import RecordingError
    from dynpf_formats.recording.reader import load

    if not path.exists():
        return False
    with suppress(RecordingError):
        end = load(path)[0].end
        if end is not None and not end.complete:
            return True
    return time.time() - path.stat().st_mtime > patience_s


def _robot(path: Path, plan: "Plan", endpoint: str) -> "Callable[[Bus], AbstractContextManager[LiveRobot]]":
    """Return what opens the bridge to a live robot, whose settings ``dynpf bridge`` has written."""
    import msgspec
    from dynpf_protocol.keys import OBSERVER
    from dynpf_runtime.bus.keys import load
    from dynpf_services.ros2.bridge import Bridge, opened_bridge

    bridge = msgspec.json.decode(path.read_bytes(), type=Bridge)
    observer = load(Path(bridge.observer), OBSERVER, datetime.now(UTC))
    return lambda bus: opened_bridge(bridge, plan.graph, bus, endpoint, observer)


def _run(options: argparse.Namespace) -> int:
    from dynpf_runtime.bus.pulse import Pulse
    from dynpf_runtime.bus.terminal import StopSignal, say
    from dynpf_services.scenario.build import plan_of

    _check_options(options)
    log = load_log(options) if options.name != "router" or options.log else None
    scenario = scenario_from(options, log)
    if options.name not in {"router", "recorder", *scenario.nodes}:
        raise UsageError(
            f"{options.name} takes no part in this scenario; its processes are {', '.join(scenario.nodes)}"
        )
    if scenario.needs_log and log is None and options.name == plan_of(scenario).graph.source:
        raise UsageError("this scenario plays an imported log: give it with --log IN.mcap (dynpf import makes one)")
    endpoint = endpoint_of(options, "listen" if options.name == "router" else "connect")
    keys = credentials_of(options, options.name, quiet=options.quiet)
    pulse = Pulse.private() if options.pulse is None else Pulse.shared(options.pulse)
    shared = {"pulse": pulse, "keys": keys, "patience_s": options.patience}
    with StopSignal.installed(options.parent) as stop:
        if options.name == "router":
            from dynpf_services.router.host import run_router

            run_router(
                plan_of(scenario), endpoint, stop, pulse=pulse, quiet=options.quiet, keys=keys, player=options.player
            )
        elif options.name == "recorder":
            from dynpf_services.recorder.host import run_recorder
            from dynpf_services.scenario.recorded import attachments_of

            path = recorder_output(options, scenario.seed)
            attachments = attachments_of(scenario, log.attachments if log else ())
            if options.sign is not None:
                check_key(options.sign)
            try:
                kept = {"durable": options.durable, "resume": options.resume}
                end = run_recorder(plan_of(scenario), endpoint, path, attachments, stop, **shared, **kept)
            finally:
                if options.sign is not None and path.is_file():
                    sign_recording(path, options.sign)
            if not options.quiet:
                say("recorder", f"{path} is complete: {end.reason}")
        else:
            from dynpf_runtime.bus.host import run_node

            plan, records = plan_of(scenario), log.records if log else []
            if options.speed is not None and options.name != plan.graph.source:
                raise UsageError(f"--speed: {options.name} follows; it is for the source, {plan.graph.source}, alone")
            plan = plan if options.speed is None else plan._replace(rate=options.speed or None)
            live = None if options.robot is None else _robot(options.robot, plan, endpoint)
            run_node(options.name, plan, endpoint, records, stop, **shared, live=live)
    return 0
