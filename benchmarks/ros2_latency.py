"""How long a live robot waits for its pose: from a scan's stamp to the estimate that it has led to, heard by the robot.

python -m benchmarks.ros2_latency [--scans N] [--set KEY=VALUE]...

A robot, its router and the processes of `dynpf bridge ros2` run on this machine; 20 scans of 60 beams a second,
N = 1000 particles, each scan taken into the filter. The times are those of the scans after the first second.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import zenoh
from dynpf_formats.ros2.types import RosTypes

from tests.integration.robots import live_robot

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
SETTINGS = (
    "estimator.n=1000",
    "estimator.min_travel=0.0",
    "estimator.min_turn=0.0",
    'estimator.start={kind="known", x=0.3, y=0.1, sigma_position=0.1, sigma_heading=0.05}',
)
FIRST = 20  # scans


def main() -> None:
    """Print the latencies in JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scans", type=int, default=400)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the scenario laser-log")
    options = parser.parse_args()
    latencies = np.array(measured(options.scans, [*SETTINGS, *options.set])[FIRST:])
    names = {"median_ms": 50, "p90_ms": 90, "p99_ms": 99}
    told = {name: round(float(np.percentile(latencies, percent)), 2) for name, percent in names.items()}
    print(json.dumps({"scans": len(latencies), **told}))


def measured(scans: int, settings: list[str]) -> list[float]:
    """Return the latencies of so many scans, ms."""
    types, found, enough = RosTypes(), dict[int, float](), threading.Event()

    def hear(sample: zenoh.Sample) -> None:
        now_ns = time.time_ns()
        stamp = types.decode(POSE, sample.payload.to_bytes()).header.stamp
        found.setdefault(stamp.sec * 10**9 + stamp.nanosec, (now_ns - stamp.sec * 10**9 - stamp.nanosec) * 1e-6)
        if len(found) >= scans:
            enough.set()

    with (
        tempfile.TemporaryDirectory() as folder,
        live_robot(types, beams=60, lost_every=sys.maxsize) as (endpoint, robot),
    ):
        subscriber = robot.ears.declare_subscriber("0/amcl_pose/**", hear)
        words = [
            "bridge",
            "ros2",
            "laser-log",
            "--connect",
            endpoint,
            "-o",
            str(Path(folder) / "run.mcap"),
            "--no-page",
        ]
        words += [word for setting in settings for word in ("--set", setting)]
        command = [sys.executable, "-m", "dynpf_lab.cli.main", *words]
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        enough.wait(120.0)
        run.send_signal(2)
        run.wait(30.0)
        subscriber.undeclare()
    return list(found.values())


if __name__ == "__main__":
    main()
