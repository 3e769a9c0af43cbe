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
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "62")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp())

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from node_overhead import BIAS, FOCAL, HEIGHT, LAMP, WIDTH, image_msg, info_msg
from procedural import wavy_sheet
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from report import finish
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

from shadow_tracer import Camera, PointLight, ShadowTracer
from shadow_tracer.ros.wire.cdr import encode_mesh

ROOT = Path(__file__).resolve().parents[1]
PROFILE = ROOT / "config" / "fastdds_large_images.xml"
PHASES = 40  # meshes, played round and round
IMAGES = 7  # depth images in turn
WARM_UP = 2.0  # s, published but not counted
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


def depth_image(number: int, case: Case) -> np.ndarray:
    """(H, W) uint16 millimetres: a wall with a few invalid pixels, and noise that is another in ``IMAGES`` successive
    frames, as of a camera: of the same image the node would use samples and rays again."""
    noise = np.random.default_rng(number % IMAGES).integers(-1, 2, (case.height, case.width))
    depth = (2500 + noise).astype(np.uint16)
    depth[::37, ::41] = 0
    return depth


class Player:
    """The publishing process: plays frames by the clock and notes when masks come back."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.node = Node("player")
        profile = QoSProfile(depth=10)
        images = QoSProfile(depth=10)
        images.reliability = ReliabilityPolicy.RELIABLE if case.reliable else ReliabilityPolicy.BEST_EFFORT
        self.depth_out = self.node.create_publisher(Image, "depth/image_rect", images)
        self.info_out = self.node.create_publisher(CameraInfo, "depth/camera_info", images)
        self.mesh_out = self.node.create_publisher(Mesh, "mesh", profile)
        self.node.create_subscription(Image, "shadow_tracer/mask", self._on_mask, profile)
        self.node.create_subscription(DiagnosticArray, "shadow_tracer/timing", self._on_timing, profile)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.meshes = [encode_mesh(*wavy_sheet(case.cells, 2 * np.pi * n / PHASES)) for n in range(PHASES)]
        self.images = [depth_image(number, case) for number in range(IMAGES)]
        self.sent: dict[int, tuple[int, float]] = {}
        self.came: dict[int, float] = {}
        self.samples: dict[int, bytes] = {}
        self.inside: list[float] = []
        self.stages: dict[str, list[float]] = {}
        self.counts: dict[str, list[int]] = {name: [] for name in COUNTS}

    def _on_mask(self, message: Image) -> None:
        now = time.perf_counter()
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        self.came[stamp] = now
        number = self.sent.get(stamp, (0, 0.0))[0]
        if number % SAMPLE == 0:
            self.samples[stamp] = bytes(message.data)

    def _on_timing(self, message: DiagnosticArray) -> None:
        for pair in message.status[0].values:
            name, _, unit = pair.key.partition(" [")
            if unit == "ms]":
                self.stages.setdefault(name, []).append(float(pair.value))
            elif name in self.counts:
                self.counts[name].append(int(pair.value))

    def spin_until(self, done: Any, seconds: float) -> bool:
        """Run callbacks until ``done()``, or until time is up."""
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)
        return bool(done())

    def play(self, rate: float, seconds: float) -> None:
        """Publish frames at a rate, callbacks in between."""
        outputs = (self.depth_out, self.info_out, self.mesh_out)
        if not self.spin_until(lambda: all(output.get_subscription_count() for output in outputs), 60.0):
            raise SystemExit("the node does not subscribe")
        if not self._first():
            raise SystemExit("no mask came back")
        begin = time.perf_counter()
        for number in range(round((seconds + WARM_UP) * rate)):
            due = begin + number / rate
            while (left := due - time.perf_counter()) > 0:
                self.executor.spin_once(timeout_sec=left)
            self.frame(number)
        self.spin_until(lambda: len(self.came) >= len(self.sent), 3.0)

    def _first(self) -> bool:
        """Frames until a mask comes back: kernels may have to be compiled, and best effort images may be lost."""
        for number in range(1, 121):
            self.frame(-number)
            if self.spin_until(lambda: self.came, 1.0):
                return True
        return False

    def frame(self, number: int) -> None:
        """Publish a mesh, and the depth image that belongs to it."""
        stamp = time.time_ns()
        if not self.case.still:
            self.mesh_out.publish(self.meshes[number % PHASES])
        elif number < 0 or number % SAMPLE == 0:
            self.mesh_out.publish(self.meshes[0])
        self.info_out.publish(info_msg(stamp, self.case.width, self.case.height))
        image = image_msg(self.images[number % IMAGES], stamp)
        self.sent[stamp] = (number, time.perf_counter())
        self.depth_out.publish(image)

    def result(self, rate: float, samples: Path) -> dict[str, Any]:
        """Figures of all frames after the warm-up; the sampled masks go to a file."""
        first = round(WARM_UP * rate)
        counted = {stamp: entry for stamp, entry in self.sent.items() if entry[0] >= first}
        latencies = [1e3 * (self.came[stamp] - at) for stamp, (_, at) in counted.items() if stamp in self.came]
        times = sorted(at for _, at in counted.values())
        kept = {stamp: mask for stamp, mask in self.samples.items() if stamp in counted}
        masks = [np.frombuffer(mask, np.uint8) for mask in kept.values()]
        np.savez_compressed(samples, numbers=[counted[stamp][0] for stamp in kept], masks=np.array(masks))
        return {
            "sent": len(counted),
            "lost": len(counted) - len(latencies),
            "rate": (len(times) - 1) / (times[-1] - times[0]),
            "latencies": latencies,
            "counts": {name: values[-1] - values[0] for name, values in self.counts.items() if values},
            "stages": {name: values[first:] for name, values in self.stages.items()},
        }


def play(case: Case, rate: float, seconds: float, samples: Path) -> None:
    """What the publishing process does; its result goes to stdout as JSON."""
    rclpy.init(args=[])
    player = Player(case)
    try:
        player.play(rate, seconds)
        print(json.dumps(player.result(rate, samples)))
    finally:
        player.executor.shutdown()
        player.node.destroy_node()
        rclpy.try_shutdown()


def compare(case: Case, samples: Path) -> tuple[int, int]:
    """Compare the sampled masks with the library's: (how many, how many had the mesh of a neighbouring frame).

    Raises:
        SystemExit: a mask is that of no mesh it could be of.
    """
    stored = np.load(samples)
    tracer = ShadowTracer(device="cpu")
    focal = FOCAL * case.width / WIDTH
    camera = Camera(case.width, case.height, focal, focal, case.width / 2, case.height / 2)
    known: dict[tuple[int, int], np.ndarray] = {}

    def of(phase: int, number: int) -> np.ndarray:
        key = phase, number % IMAGES
        if key not in known:
            tracer.scene.put("mesh", *wavy_sheet(case.cells, 2 * np.pi * phase / PHASES))
            known[key] = tracer.trace(depth_image(number, case), camera, [PointLight("lamp", LAMP)], bias=BIAS).mask()
        return known[key]

    neighbours = 0
    for number, mask in zip(stored["numbers"], stored["masks"], strict=True):
        shape = mask.reshape(case.height, case.width)
        for step in (0, 1, -1, 2, -2):
            phase = 0 if case.still else int(number + step) % PHASES
            if np.array_equal(shape, of(phase, int(number))):
                neighbours += step != 0
                break
        else:
            raise SystemExit(f"{case.name}: the mask of frame {number} is not the library's")
    if not len(stored["masks"]):
        raise SystemExit(f"{case.name}: no mask to compare")
    return len(stored["masks"]), neighbours


def measure(case: Case, rate: float, seconds: float) -> dict[str, Any]:
    """Run a node and a publisher; a line of the table."""
    values = {"light_names": ["lamp"], "lights.lamp.position": list(LAMP), "device": "cpu"}
    values |= {"bias.constant": BIAS.constant, "bias.quadratic": BIAS.quadratic, "bias.normal": BIAS.normal}
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
            transport = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE)} if case.large else {}
            arguments = ["--play", json.dumps(asdict(case)), "--samples", str(samples)]
            arguments += ["--rate", str(rate), "--seconds", str(seconds)]
            player = subprocess.run(
                [sys.executable, str(Path(__file__).resolve()), *arguments],
                env={**environment, **transport}, stdout=subprocess.PIPE, check=True,
            )  # fmt: skip
        finally:
            node.terminate()
            node.wait(30)
        compared, neighbours = compare(case, samples)
    result = json.loads(player.stdout)
    return _row(case, result, compared, neighbours)


def _row(case: Case, result: dict[str, Any], compared: int, neighbours: int) -> dict[str, Any]:
    latencies = result["latencies"]
    stages = {name: float(np.median(values)) for name, values in result["stages"].items() if values}
    return {
        "case": case.name,
        "rate [Hz]": result["rate"],
        "sent": result["sent"],
        "lost": result["lost"],
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
