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
import subprocess
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
from node_overhead import BIAS, FOCAL, LAMP, WIDTH, image_msg, info_msg
from procedural import wavy_sheet
from rate import IMAGES, PHASES, PROFILE, ROOT
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from report import finish
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

from shadow_tracer import Camera, PointLight, ShadowTracer
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.testing import NodeProcess

WARM_UP = 2.0  # s, published but not counted
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


def depth_image(number: int, case: Case) -> np.ndarray:
    """(H, W) uint16 millimetres of a wall with noise, another one in ``IMAGES`` successive images."""
    noise = np.random.default_rng(number % IMAGES).integers(-1, 2, (case.height, case.width))
    return (2500 + noise).astype(np.uint16)


class Player:
    """The publishing process."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.node = Node("player")
        profile = QoSProfile(depth=10)
        self.mesh_out = self.node.create_publisher(Mesh, "/mesh", profile)
        self.out: dict[str, tuple[Any, Any]] = {}
        self.sent: dict[tuple[str, int], tuple[int, float]] = {}
        self.came: dict[tuple[str, int], tuple[float, bytes | None]] = {}
        for camera in case.cameras:
            depth = self.node.create_publisher(Image, f"/{camera}/depth/image_rect", profile)
            info = self.node.create_publisher(CameraInfo, f"/{camera}/depth/camera_info", profile)
            self.out[camera] = depth, info
            self.node.create_subscription(
                Image, case.mask(camera), lambda message, camera=camera: self._on_mask(camera, message), profile
            )
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.meshes = [encode_mesh(*wavy_sheet(CELLS, 2 * np.pi * n / PHASES)) for n in range(PHASES)]
        self.images = [depth_image(number, case) for number in range(IMAGES)]

    def _on_mask(self, camera: str, message: Image) -> None:
        now, stamp = time.perf_counter(), message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        number = self.sent.get((camera, stamp), (1, 0.0))[0]
        self.came[camera, stamp] = now, bytes(message.data) if number % SAMPLE == 0 else None

    def spin_until(self, done: Any, seconds: float) -> bool:
        """Run callbacks until ``done()``, or until time is up."""
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)
        return bool(done())

    def play(self, seconds: float) -> None:
        """Publish: the cameras evenly one after the other, a mesh before the images of the first."""
        outputs = [self.mesh_out, *(each for pair in self.out.values() for each in pair)]
        nodes = 1 if self.case.together else self.case.count
        if not self.spin_until(
            lambda: (
                all(each.get_subscription_count() for each in outputs)
                and self.mesh_out.get_subscription_count() == nodes
            ),
            60.0,
        ):
            raise SystemExit("the nodes do not subscribe")
        begin, step = time.perf_counter() + 0.1, 1.0 / (self.case.rate * self.case.count)
        for turn in range(round((seconds + WARM_UP) * self.case.rate) * self.case.count):
            while (left := begin + turn * step - time.perf_counter()) > 0:
                self.executor.spin_once(timeout_sec=left)
            number, camera = divmod(turn, self.case.count)
            self.image(self.case.cameras[camera], number, camera == 0)
        self.spin_until(lambda: len(self.came) >= len(self.sent), 3.0)

    def image(self, camera: str, number: int, mesh: bool) -> None:
        """Publish an image, after a mesh or without."""
        stamp, (depth, info) = time.time_ns(), self.out[camera]
        if mesh:
            self.mesh_out.publish(self.meshes[number % PHASES])
        info.publish(info_msg(stamp, self.case.width, self.case.height))
        message = image_msg(self.images[number % IMAGES], stamp)
        self.sent[camera, stamp] = number, time.perf_counter()
        depth.publish(message)

    def result(self, samples: Path) -> dict[str, Any]:
        """Figures after the warm-up; the sampled masks go to a file."""
        first = round(WARM_UP * self.case.rate)
        counted = {key: entry for key, entry in self.sent.items() if entry[0] >= first}
        kept = {key: self.came[key][1] for key in counted if key in self.came and self.came[key][1] is not None}
        masks = [np.frombuffer(mask, np.uint8) for mask in kept.values() if mask is not None]
        np.savez_compressed(samples, numbers=[counted[key][0] for key in kept], masks=np.array(masks))
        came = {
            camera: [1e3 * (self.came[key][0] - at) for key, (_, at) in counted.items()
                     if key in self.came and key[0] == camera]
            for camera in self.case.cameras
        }  # fmt: skip
        return {"sent": len(counted) // self.case.count, "came": came}


def play(case: Case, seconds: float, samples: Path) -> None:
    """What the publishing process does; its result goes to stdout as JSON."""
    rclpy.init(args=[])
    player = Player(case)
    try:
        player.play(seconds)
        print(json.dumps(player.result(samples)))
    finally:
        player.executor.shutdown()
        player.node.destroy_node()
        rclpy.try_shutdown()


def compare(case: Case, samples: Path) -> tuple[int, int]:
    """Compare the sampled masks with the library's: how many, and how many had the mesh of a neighbouring image.

    Raises:
        SystemExit: a mask is that of no mesh it could be of.
    """
    stored, tracer = np.load(samples), ShadowTracer(device="cpu")
    focal = FOCAL * case.width / WIDTH
    camera = Camera(case.width, case.height, focal, focal, case.width / 2, case.height / 2)
    neighbours = 0
    for number, mask in zip(stored["numbers"].tolist(), stored["masks"], strict=True):
        for step in (0, 1, -1, 2, -2, 3, -3):
            tracer.scene.put("mesh", *wavy_sheet(CELLS, 2 * np.pi * ((number + step) % PHASES) / PHASES))
            depth = depth_image(number, case)
            found = tracer.trace(depth, camera, [PointLight("lamp", LAMP)], bias=BIAS).mask()
            if np.array_equal(mask.reshape(found.shape), found):
                neighbours += step != 0
                break
        else:
            raise SystemExit(f"{case.name}: the mask of image {number} is not the library's")
    if not len(stored["masks"]):
        raise SystemExit(f"{case.name}: no mask to compare")
    return len(stored["masks"]), neighbours


def nodes_of(case: Case) -> list[NodeProcess]:
    """The nodes, started side by side."""
    values: dict[str, Any] = {"light_names": ["lamp"], "lights.lamp.position": list(LAMP), "pose_source": "parameter"}
    values |= {"bias.constant": BIAS.constant, "bias.quadratic": BIAS.quadratic, "bias.normal": BIAS.normal}
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
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    begin = time.monotonic()
    nodes = nodes_of(case)
    try:
        for node in nodes:
            node.wait_for("Ready")
        start, started = time.monotonic() - begin, sum(processor_seconds(node.pid) for node in nodes)
        with tempfile.TemporaryDirectory() as folder:
            samples = Path(folder) / "masks.npz"
            arguments = ["--play", json.dumps(asdict(case)), "--samples", str(samples), "--seconds", str(seconds)]
            player = subprocess.run(
                [sys.executable, str(Path(__file__).resolve()), *arguments], stdout=subprocess.PIPE, check=True,
                env={**os.environ, "PYTHONPATH": path, "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE)},
            )  # fmt: skip
            memory = sum(proportional(node.pid) for node in nodes)
            worked = sum(processor_seconds(node.pid) for node in nodes) - started
            for node in nodes:
                node.close()
            compared, neighbours = compare(case, samples)
    finally:
        for node in nodes:
            node.close()
    result = json.loads(player.stdout)
    came = result["came"]
    every = np.concatenate([np.asarray(times) for times in came.values()])
    answered = [100.0 * len(times) / result["sent"] for times in came.values()]
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
