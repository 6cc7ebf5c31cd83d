"""``dynpf bridge``: localize a live ROS 2 robot, and record the run."""

import argparse
import multiprocessing
import re
import sys
import tempfile
from pathlib import Path

from dynpf_protocol.errors import DynpfError, RunError, UsageError

from dynpf_lab.cli.arguments import add_json, add_set
from dynpf_lab.cli.loading import loading
from dynpf_lab.cli.options import add_code
from dynpf_lab.cli.page import add_no_page
from dynpf_lab.cli.processes import add_restarts, run_processes
from dynpf_lab.cli.robots import add_robot, seconds
from dynpf_lab.cli.run import check_output, default_output, print_summary

__all__ = ["add_arguments"]

FORMATS = ("rmw_zenoh", "ros2dds")
WORDS = ("pose", "cloud", "tf", "diagnostics")
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``dynpf bridge``."""
    parser.add_argument("system", choices=["ros2"], help="what the robot runs: ROS 2")
    parser.add_argument("scenario", metavar="SCENARIO", help="name (dynpf list) or TOML file, of one that plays a log")
    add_robot(parser, required=False)
    parser.add_argument(
        "--dds", action="store_true", help="instead of --connect: join the robot's DDS domain, without any router"
    )
    parser.add_argument(
        "--format",
        choices=FORMATS,
        default=FORMATS[0],
        help="how the robot's topics stand on Zenoh: by rmw_zenoh, or by zenoh-bridge-ros2dds, for a robot on DDS"
        " (default: %(default)s)",
    )
    parser.add_argument(
        "--namespace", type=_namespace, default="", metavar="/r", help="of one robot among several (default: none)"
    )
    parser.add_argument(
        "--publish",
        type=_publish,
        default=WORDS,
        metavar="WORD,...",
        help=f"what goes back to the robot, of {','.join(WORDS)}; none: nothing (default: all)",
    )
    parser.add_argument("--scan", metavar="TOPIC", help="the scanner's topic (default: the one of the widest view)")
    parser.add_argument("--odometry", metavar="TOPIC", help="the odometry's topic, or tf (default: what there is)")
    parser.add_argument(
        "--imu",
        type=_topic,
        metavar="TOPIC",
        help="a gyro whose turns replace those of the odometry (default: the odometry's own)",
    )
    parser.add_argument("--base", metavar="FRAME", help="the robot's frame (default: of the odometry)")
    parser.add_argument(
        "--wait",
        type=seconds,
        default=20.0,
        metavar="S",
        help="how long to wait for the first scan, odometry and map (default: %(default)g)",
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed of everything random in the run")
    add_set(parser, "override one key of the scenario, such as estimator.n=500")
    add_code(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="RUN.mcap", help="the recording to write (default: runs/)")
    add_restarts(parser)
    add_no_page(parser)
    add_json(parser, "print the metrics of the run as JSON")
    parser.set_defaults(run=run)


def _namespace(text: str) -> str:
    namespace = "/" + text.strip("/") if text.strip("/") else ""
    if namespace and _NAMESPACE.fullmatch(namespace) is None:
        raise argparse.ArgumentTypeError(f"{text}: expected a namespace such as /bot1")
    return namespace


def _topic(text: str) -> str:
    return "/" + text.strip("/")


def _publish(text: str) -> tuple[str, ...]:
    words = () if text == "none" else tuple(dict.fromkeys(text.split(",")))
    if unknown := [word for word in words if word not in WORDS]:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r}: expected some of {','.join(WORDS)}, or none")
    return words


def run(options: argparse.Namespace) -> int:
    """Execute ``dynpf bridge`` and return its exit code."""
    _check_possible(options)
    path = options.output or default_output(Path(options.scenario).stem, options.seed or 1)
    check_output(path)
    with tempfile.TemporaryDirectory(prefix="dynpf-bridge-") as name:
        folder = Path(name)
        at = "on DDS" if options.dds else f"at {options.connect}"
        log, settings = folder / "robot.mcap", folder / "robot.json"
        print(f"dynpf bridge: waiting for the robot {at}", file=sys.stderr)
        _in_a_process(options, log, settings, folder / "guests")
        _run(options, path, log, settings, folder / "guests")
    return print_summary("bridge", path, with_page=not options.no_page, as_json=options.json)


def _check_possible(options: argparse.Namespace) -> None:
    """Raise UsageError for what needs no robot to be told."""
    from dynpf_experiments.extras import needing
    from dynpf_services.scenario.load import load_scenario
    from dynpf_services.scenario.user_code import add_folders, code_folders

    if options.dds == (options.connect is not None):
        raise UsageError("name the robot's router, --connect tcp/ROBOT:7447, or join its domain, --dds")
    with needing("rosbags", extra="ros", what="the bridge to ROS 2"):
        import rosbags  # noqa: F401
    if options.dds:
        with needing("cyclonedds", extra="dds", what="a robot on DDS"):
            import cyclonedds  # noqa: F401
    if options.dds and options.format != FORMATS[0]:
        raise UsageError(f"--format {options.format}: is for a robot behind a router; --dds joins its domain itself")
    if options.format == "ros2dds" and options.domain:
        raise UsageError(
            f"--domain {options.domain}: zenoh-bridge-ros2dds has a domain, its keys have none; leave it out"
        )
    add_folders(code_folders(options.code, options.scenario))
    scenario = load_scenario(options.scenario, overrides=options.overrides, seed=options.seed, clock="realtime")
    if not scenario.needs_log:
        raise UsageError(f"{options.scenario}: plays no log, so it has no use for a robot; laser-log does")


def _in_a_process(options: argparse.Namespace, log: Path, settings: Path, observer: Path) -> None:
    """Look at the robot in a process of its own: the run's processes are copies of this one, which has no threads."""
    process = multiprocessing.Process(target=_look, args=(options, log, settings, observer))
    process.start()
    try:
        process.join()
    except KeyboardInterrupt:
        process.join()
        raise
    if process.exitcode:
        raise SystemExit(process.exitcode)  # it has said why


def _look(options: argparse.Namespace, log: Path, settings: Path, observer: Path) -> None:
    import msgspec
    from dynpf_formats.importers.bag_plan import BagChoice
    from dynpf_formats.ros2.robot import RobotPlan
    from dynpf_runtime.bus.terminal import StopSignal
    from dynpf_services.ros2.bridge import Bridge
    from dynpf_services.ros2.discovery import look_at_robot
    from dynpf_services.ros2.reach import Reach

    reach = Reach(endpoint=options.connect or "", wire=options.format, domain=options.domain)

    def made(plan: RobotPlan, humble: bool) -> Bridge:
        return Bridge(
            reach=reach,
            namespace=options.namespace,
            publish=options.publish,
            humble=humble,
            plan=plan,
            observer=str(observer),
        )

    choice = BagChoice(scan=options.scan, odometry=options.odometry, base=options.base)
    try:
        with StopSignal.installed() as stop:
            bridge = look_at_robot(
                made,
                reach,
                options.namespace,
                choice,
                imu=options.imu,
                patience_s=options.wait,
                log=log,
                stopped=lambda: stop.requested,
            )
    except DynpfError as error:
        print(f"dynpf bridge: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(1)  # who has started this process says so
    plan = bridge.plan
    print(f"dynpf bridge: hears {plan.scan}, odometry {plan.odometry or 'none'}, base {plan.base}", file=sys.stderr)
    settings.write_bytes(msgspec.json.encode(bridge))


def _run(options: argparse.Namespace, path: Path, log_path: Path, settings: Path, guests: Path) -> None:
    from dynpf_services.scenario.build import plan_of
    from dynpf_services.scenario.load import load_scenario
    from dynpf_services.scenario.played_log import PlayedLog
    from dynpf_services.scenario.user_code import code_folders

    with loading():
        log = PlayedLog(log_path)
        scenario = load_scenario(
            options.scenario, overrides=options.overrides, seed=options.seed, clock="realtime", log=log.facts
        )
        plan = plan_of(scenario)
        for spec in plan.graph.specs.values():
            spec.build()
    code = code_folders(options.code, options.scenario)
    further = {plan.graph.source: ["--robot", str(settings)]}
    try:
        run_processes(scenario, plan, path, log, code, guests=guests, further=further, restarts=options.restarts)
    except RunError:
        if path.is_file():
            print(f"dynpf bridge: the messages recorded so far are in {path}", file=sys.stderr)
        raise
