# SPDX-License-Identifier: Apache-2.0
"""Several cameras and a mesh that moves all the time: one node for all, beside a node for each.

One process publishes, the nodes are others. Latency is from just before an image is published to the callback of its
mask in the publishing process. A sample of the masks is compared with the library's; mesh and images are topics without
an order between them, so a mask may be that of a neighbouring mesh. Memory is the proportional set size of all nodes
when all images have been sent: what they share counts once. The start is the time until all nodes trace.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "63")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp())

import numpy as np
import rclpy
from publishing import NODE, WARM_UP, Publisher, Topics, compare, run_publisher
from report import finish

from shadow_tracer.testing import NodeProcess

SAMPLE = 20  # one mask of so many of each camera is compared
CELLS = 187  # 2 * 187^2 = 69,938 triangles


@dataclass(frozen=True)
class Case:
    """So many cameras of a size and rate; ``together``: in one node."""

    count: int
    width: int
    height: int
    rate: float
    together: bool

    @property
    def name(self) -> str:
        """In words."""
        nodes = "one node" if self.together else f"{self.count} nodes"
        return f"{self.count} x {self.width} x {self.height} at {self.rate:g} Hz, {nodes}"

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras."""
        return [f"c{number}" for number in range(self.count)]

    def mask(self, camera: str) -> str:
        """Topic of the masks of a camera."""
        return f"/shadow_tracer/{camera}/mask" if self.together else f"/{camera}/shadow_tracer/mask"


CASES = tuple(
    Case(*what, together) for what in ((4, 424, 240, 15.0), (2, 640, 480, 30.0)) for together in (True, False)
)


def play(case: Case, seconds: float, samples: Path) -> None:
    """What the publishing process does; its result goes to stdout as JSON."""
    rclpy.init(args=[])
    cameras = {
        camera: Topics(f"/{camera}/depth/image_rect", f"/{camera}/depth/camera_info", case.mask(camera))
        for camera in case.cameras
    }
    publisher = Publisher(CELLS, case.width, case.height, cameras, SAMPLE)

    def before(camera: int, number: int) -> None:
        if camera == 0:
            publisher.mesh(number)

    try:
        publisher.wait_for(1 if case.together else case.count)
        publisher.play(case.rate, seconds, before)
        print(json.dumps(publisher.result(case.rate, samples)))
    finally:
        publisher.close()


def nodes_of(case: Case) -> list[NodeProcess]:
    """The nodes, started side by side."""
    values: dict[str, Any] = {**NODE, "pose_source": "parameter"}
    values |= {"bounds.max_triangles": 100_000, "bounds.max_rays": case.width * case.height, "bounds.max_lights": 4}
    if case.together:
        return [NodeProcess({**values, "camera_names": case.cameras})]
    remaps = [["-r", f"__ns:=/{camera}", "-r", "mesh:=/mesh"] for camera in case.cameras]
    return [NodeProcess(values, arguments=remap) for remap in remaps]


def proportional(pid: int) -> float:
    """Proportional set size of a process [MiB]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024.0


def processor_seconds(pid: int) -> float:
    """Seconds of processor time that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(case: Case, seconds: float) -> dict[str, Any]:
    """Run the nodes and a publisher; a line of the table."""
    begin = time.monotonic()
    nodes = nodes_of(case)
    try:
        for node in nodes:
            node.wait_for("Ready")
        start, started = time.monotonic() - begin, sum(processor_seconds(node.pid) for node in nodes)
        with tempfile.TemporaryDirectory() as folder:
            samples = Path(folder) / "masks.npz"
            result = run_publisher(__file__, asdict(case), samples, True, "--seconds", str(seconds))
            memory = sum(proportional(node.pid) for node in nodes)
            worked = sum(processor_seconds(node.pid) for node in nodes) - started
            for node in nodes:
                node.close()
            compared, neighbours = compare(case.name, samples, CELLS, case.width, case.height, 3)
    finally:
        for node in nodes:
            node.close()
    every = np.concatenate([np.asarray(times) for times in result["took"].values()])
    answered = [100.0 * len(times) * case.count / result["sent"] for times in result["took"].values()]
    return {
        "case": case.name,
        "answered, each camera [%]": " ".join(f"{share:.0f}" for share in answered),
        "median [ms]": float(np.median(every)),
        "99 % [ms]": float(np.percentile(every, 99)),
        "memory [MiB]": memory,
        "start [s]": start,
        "start, processor [s]": started,
        "processor, per mask [ms]": 1e3 * worked / len(every) * seconds / (seconds + WARM_UP),
        "masks compared": compared,
        "with a neighbouring mesh": neighbours,
        "load": os.getloadavg()[0],
    }


def main() -> int:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--cases", type=int, nargs="*", default=list(range(len(CASES))), help="numbers from 0")
    parser.add_argument("--json", help="file to write")
    parser.add_argument("--play", help=argparse.SUPPRESS)
    parser.add_argument("--samples", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.play:
        play(Case(**json.loads(options.play)), options.seconds, Path(options.samples))
        return 0
    rows = []
    for number in options.cases:
        rows.append(measure(CASES[number], options.seconds))
        print(rows[-1], flush=True)
    finish(f"{2 * CELLS**2} triangles, all of which move with every image of a camera", rows, options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
