# SPDX-License-Identifier: Apache-2.0
"""Depth at camera rate and a mesh that changes with every image, published by one process and traced by another.

Latency is from just before the depth image is published to the callback of its mask in the publishing process, so that
both transports are in it. No figure is printed before the masks of a sample of frames have been compared with the
library's for the same depth and mesh; mesh and depth are two topics, so the mesh of a mask may be a neighbouring one,
and how many are is printed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "62")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp())

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from node_overhead import HEIGHT, WIDTH
from publishing import NODE, WARM_UP, Publisher, Topics, compare, run_publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from report import ROOT, finish

TOPICS = Topics("/depth/image_rect", "/depth/camera_info", "/shadow_tracer/mask")
COUNTS = ("skipped before the node", "dropped")  # numbers of ~/timing
SAMPLE = 30  # one mask of so many is compared
MEDIAN_LIMIT, SLOW_LIMIT = 40.0, 80.0  # ms, for the case that must hold


@dataclass(frozen=True)
class Case:
    """One setting.

    Attributes:
        cells: the sheet has 2 * cells^2 triangles.
        reliable: QoS of depth and camera_info.
        large: the publisher has the large segment of config/fastdds_large_images.xml.
        every: the node's parameter process is every, not latest: a frame that takes longer delays the next, and none is
            passed over.
        must_hold: its figures are asserted.
        width, height: pixels of the depth image.
        still: one mesh, sent again every second or so: behind large images of the same process a mesh that changes with
            each would come several frames late with stock Fast DDS.
        taken_best_effort: the node is told to take images and camera_info best effort, whatever is offered.
    """

    cells: int
    every: bool = False
    reliable: bool = True
    large: bool = True
    must_hold: bool = False
    width: int = WIDTH
    height: int = HEIGHT
    taken_best_effort: bool = False
    still: bool = False

    @property
    def name(self) -> str:
        """In words."""
        transport = "large segment" if self.large else "stock Fast DDS"
        order = "every" if self.every else "latest"
        size = "" if (self.width, self.height) == (WIDTH, HEIGHT) else f"{self.width} x {self.height}, "
        offered = "reliable" if self.reliable else "best effort"
        taken = " but taken best effort" if self.taken_best_effort else ""
        return f"{size}{2 * self.cells**2} triangles, {order}, {offered}{taken}, {transport}"


CASES = (
    Case(100, every=True, must_hold=True),
    Case(100),
    Case(100, large=False),
    Case(100, reliable=False),
    Case(100, reliable=False, large=False),
    Case(187, every=True),
    Case(187),
    # The usual cameras, stock settings on both sides: what comes, and what came of it when the node asked best effort.
    *(
        Case(10, large=False, width=width, height=height, taken_best_effort=taken_best_effort, still=True)
        for width, height in ((640, 480), (848, 480), (1280, 720))
        for taken_best_effort in (False, True)
    ),
)


class Player(Publisher):
    """The publishing process: plays frames by the clock and notes what the node says of them."""

    def __init__(self, case: Case) -> None:
        self.case = case
        images = QoSProfile(depth=10)
        images.reliability = ReliabilityPolicy.RELIABLE if case.reliable else ReliabilityPolicy.BEST_EFFORT
        super().__init__(case.cells, case.width, case.height, {"": TOPICS}, SAMPLE, images)
        self.hear(DiagnosticArray, "/shadow_tracer/timing", self._on_timing)
        self.stages: dict[str, list[float]] = {}
        self.counts: dict[str, list[int]] = {name: [] for name in COUNTS}

    def _on_timing(self, message: DiagnosticArray) -> None:
        for pair in message.status[0].values:
            name, _, unit = pair.key.partition(" [")
            if unit == "ms]":
                self.stages.setdefault(name, []).append(float(pair.value))
            elif name in self.counts:
                self.counts[name].append(int(pair.value))

    def begin(self) -> None:
        """Frames until a mask comes back: kernels may have to be compiled, and best effort images may be lost. Raises
        SystemExit."""
        self.wait_for(1)
        for number in range(1, 121):
            self.before(0, -number)
            self.image("", -number)
            if self.spin_until(lambda: self.came, 1.0):
                return
        raise SystemExit("no mask came back")

    def before(self, _: int, number: int) -> None:
        """Publish the mesh that belongs to an image."""
        if not self.case.still:
            self.mesh(number)
        elif number < 0 or number % SAMPLE == 0:
            self.mesh(0)

    def said(self, rate: float) -> dict[str, Any]:
        """What the node said after the warm-up."""
        first = round(WARM_UP * rate)
        return {
            "counts": {name: values[-1] - values[0] for name, values in self.counts.items() if values},
            "stages": {name: values[first:] for name, values in self.stages.items()},
        }


def play(case: Case, rate: float, seconds: float, samples: Path) -> None:
    """What the publishing process does; its result goes to stdout as JSON."""
    rclpy.init(args=[])
    player = Player(case)
    try:
        player.begin()
        player.play(rate, seconds, player.before)
        print(json.dumps(player.result(rate, samples) | player.said(rate)))
    finally:
        player.close()


def measure(case: Case, rate: float, seconds: float) -> dict[str, Any]:
    """Run a node and a publisher; a line of the table."""
    values: dict[str, Any] = {**NODE, "device": "cpu"}
    if case.every:
        values["process"] = "every"
    if case.taken_best_effort:
        topics = ("depth/image_rect", "depth/camera_info")
        values |= {f"qos_overrides./{topic}.subscription.reliability": "best_effort" for topic in topics}
    flags = [word for name, value in values.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    environment = {**os.environ, "PYTHONPATH": path}
    environment.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    command = [sys.executable, "-m", "shadow_tracer.ros", "--ros-args", *flags]
    with tempfile.TemporaryDirectory() as folder:
        samples = Path(folder) / "masks.npz"
        node = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment)
        try:
            more = ("--rate", str(rate), "--seconds", str(seconds))
            result = run_publisher(__file__, asdict(case), samples, case.large, *more)
        finally:
            node.terminate()
            node.wait(30)
        size = case.width, case.height
        compared, neighbours = compare(case.name, samples, case.cells, *size, 2, case.still)
    return _row(case, result, compared, neighbours)


def _row(case: Case, result: dict[str, Any], compared: int, neighbours: int) -> dict[str, Any]:
    latencies = result["took"][""]
    stages = {name: float(np.median(values)) for name, values in result["stages"].items() if values}
    return {
        "case": case.name,
        "rate [Hz]": result["rate"],
        "sent": result["sent"],
        "lost": result["sent"] - len(latencies),
        "not received": result["counts"].get(COUNTS[0], 0),
        "passed over": result["counts"].get(COUNTS[1], 0),
        "median [ms]": float(np.median(latencies)),
        "99 % [ms]": float(np.percentile(latencies, 99)),
        "slowest [ms]": float(np.max(latencies)),
        "in the node, median [ms]": stages.get("total", float("nan")),
        "of which trace [ms]": stages.get("trace", float("nan")),
        "masks compared": compared,
        "with a neighbouring mesh": neighbours,
    }


def main() -> int:
    """Measure, print a table, and say by the exit code whether what must hold does."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--cases", type=int, nargs="*", default=list(range(len(CASES))), help="numbers from 0")
    parser.add_argument("--json", help="file to write")
    parser.add_argument("--play", help=argparse.SUPPRESS)
    parser.add_argument("--samples", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.play:
        play(Case(**json.loads(options.play)), options.rate, options.seconds, Path(options.samples))
        return 0
    rows, failed = [], False
    for case in itertools.compress(CASES, [number in options.cases for number in range(len(CASES))]):
        row = measure(case, options.rate, options.seconds)
        rows.append(row)
        if case.must_hold and (row["lost"] or row["median [ms]"] > MEDIAN_LIMIT or row["99 % [ms]"] > SLOW_LIMIT):
            failed = True
        print(f"{case.name}: {row['lost']} lost, {row['median [ms]']:.1f} / {row['99 % [ms]']:.1f} ms", flush=True)
    finish(
        f"{WIDTH} x {HEIGHT} 16UC1 unless said otherwise, the mesh changes with every image, two processes",
        rows,
        options.json,
    )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
