# SPDX-License-Identifier: Apache-2.0
"""The publishing process of the benchmarks of the node: depth images of cameras and a mesh that changes with them, the
masks that come back, and their comparison with the library's.

Mesh and images are topics without an order between them, so the mesh of a mask may be a neighbouring one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from node_overhead import BIAS, FOCAL, LAMP, WIDTH, image_msg, info_msg
from procedural import wavy_sheet
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from report import ROOT
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

from shadow_tracer import Camera, PointLight, ShadowTracer
from shadow_tracer.ros.wire.cdr import encode_mesh

PROFILE = ROOT / "config" / "fastdds_large_images.xml"
PHASES = 40  # meshes, played round and round
IMAGES = 7  # depth images in turn
WARM_UP = 2.0  # s, published but not counted
NODE = {
    "light_names": ["lamp"], "lights.lamp.position": list(LAMP), "bias.constant": BIAS.constant,
    "bias.quadratic": BIAS.quadratic, "bias.normal": BIAS.normal,
}  # fmt: skip
"""Parameters of a node whose masks :func:`compare` knows."""


class Topics(NamedTuple):
    """Of a camera, and where its masks come from."""

    depth: str
    info: str
    mask: str


def depth_image(number: int, width: int, height: int) -> np.ndarray:
    """(H, W) uint16 millimetres: a wall with a few invalid pixels, and noise that is another in ``IMAGES`` successive
    frames, as of a camera: of the same image the node would use samples and rays again."""
    noise = np.random.default_rng(number % IMAGES).integers(-1, 2, (height, width))
    depth = (2500 + noise).astype(np.uint16)
    depth[::37, ::41] = 0
    return depth


def sheet(cells: int, phase: int) -> tuple[np.ndarray, np.ndarray]:
    """The mesh of a phase: vertices and 2 * cells^2 triangles."""
    return wavy_sheet(cells, 2 * np.pi * phase / PHASES)


class Publisher:
    """Publishes by the clock and notes when masks come back.

    Args:
        cells: of the sheet.
        width, height: of the images.
        cameras: topics, by name.
        sample: one mask of so many of each camera is kept.
        images: how images and camera_info are offered; None: reliably.

    Attributes:
        sent: number and time of each image, by camera and stamp [ns].
        came: when its mask came.
    """

    def __init__(
        self, cells: int, width: int, height: int, cameras: Mapping[str, Topics], sample: int,
        images: QoSProfile | None = None,
    ) -> None:  # fmt: skip
        self.node = Node("player")
        self._profile = QoSProfile(depth=10)
        self.mesh_out = self.node.create_publisher(Mesh, "/mesh", self._profile)
        self._out: dict[str, tuple[Any, Any]] = {}
        self.sent: dict[tuple[str, int], tuple[int, float]] = {}
        self.came: dict[tuple[str, int], float] = {}
        self._masks: dict[tuple[str, int], bytes] = {}
        self._sample = sample
        self._size = width, height
        self._cameras = list(cameras)
        for camera, topics in cameras.items():
            depth = self.node.create_publisher(Image, topics.depth, images or self._profile)
            self._out[camera] = depth, self.node.create_publisher(CameraInfo, topics.info, images or self._profile)
            self.hear(Image, topics.mask, lambda message, camera=camera: self._on_mask(camera, message))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self._meshes = [encode_mesh(*sheet(cells, phase)) for phase in range(PHASES)]
        self._images = [depth_image(number, width, height) for number in range(IMAGES)]

    def hear(self, kind: Any, topic: str, callback: Any) -> None:
        """Subscribe to a topic."""
        self.node.create_subscription(kind, topic, callback, self._profile)

    def _on_mask(self, camera: str, message: Image) -> None:
        key = camera, message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        self.came[key] = time.perf_counter()
        if self.sent.get(key, (1, 0.0))[0] % self._sample == 0:
            self._masks[key] = bytes(message.data)

    def spin_until(self, done: Any, seconds: float) -> bool:
        """Run callbacks until ``done()``, or until time is up."""
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)
        return bool(done())

    def wait_for(self, nodes: int) -> None:
        """Wait until so many nodes hear the mesh, and each image is heard. Raises SystemExit."""
        outputs = [each for pair in self._out.values() for each in pair]

        def heard() -> bool:
            counts = [each.get_subscription_count() for each in outputs]
            return all(counts) and self.mesh_out.get_subscription_count() >= nodes

        if not self.spin_until(heard, 60.0):
            raise SystemExit("the nodes do not subscribe")

    def play(self, rate: float, seconds: float, before: Any) -> None:
        """Publish the cameras evenly one after the other, each at a rate; ``before(camera, number)`` comes before an
        image, callbacks in between."""
        count = len(self._cameras)
        begin = time.perf_counter()
        for turn in range(round((seconds + WARM_UP) * rate) * count):
            while (left := begin + turn / (rate * count) - time.perf_counter()) > 0:
                self.executor.spin_once(timeout_sec=left)
            number, camera = divmod(turn, count)
            before(camera, number)
            self.image(self._cameras[camera], number)
        self.spin_until(lambda: len(self.came) >= len(self.sent), 3.0)

    def mesh(self, phase: int) -> None:
        """Publish a mesh."""
        self.mesh_out.publish(self._meshes[phase % PHASES])

    def image(self, camera: str, number: int) -> None:
        """Publish an image."""
        stamp, (depth, info) = time.time_ns(), self._out[camera]
        info.publish(info_msg(stamp, *self._size))
        message = image_msg(self._images[number % IMAGES], stamp)
        self.sent[camera, stamp] = number, time.perf_counter()
        depth.publish(message)

    def result(self, rate: float, samples: Path) -> dict[str, Any]:
        """Figures of all images after the warm-up; the sampled masks go to a file.

        Returns:
            Images sent, their rate [Hz], and by camera how long masks took [ms]; all by JSON.
        """
        first = round(WARM_UP * rate)
        counted = {key: entry for key, entry in self.sent.items() if entry[0] >= first}
        kept = {key: mask for key, mask in self._masks.items() if key in counted}
        masks = [np.frombuffer(mask, np.uint8) for mask in kept.values()]
        np.savez_compressed(samples, numbers=[counted[key][0] for key in kept], masks=np.array(masks))
        took: dict[str, list[float]] = {camera: [] for camera in self._cameras}
        for key, (_, at) in counted.items():
            if key in self.came:
                took[key[0]].append(1e3 * (self.came[key] - at))
        times = sorted(at for _, at in counted.values())
        return {"sent": len(counted), "rate": (len(times) - 1) / (times[-1] - times[0]), "took": took}

    def close(self) -> None:
        """End."""
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()


def run_publisher(script: str, case: Any, samples: Path, large: bool, *more: str) -> dict[str, Any]:
    """Run a benchmark again as the publishing process, with ``--play`` and a case as JSON; its result.

    Args:
        script: file of the benchmark.
        case: as JSON takes it.
        samples: file for masks.
        large: with the large segment of config/fastdds_large_images.xml.
        more: further options.
    """
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    environment = {**os.environ, "PYTHONPATH": path}
    environment.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    if large:
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROFILE)
    command = [sys.executable, str(Path(script).resolve()), "--play", json.dumps(case), "--samples", str(samples)]
    done = subprocess.run([*command, *more], env=environment, stdout=subprocess.PIPE, check=True)
    return dict(json.loads(done.stdout))


def compare(
    name: str, samples: Path, cells: int, width: int, height: int, far: int, still: bool = False
) -> tuple[int, int]:
    """Compare sampled masks with the library's: how many, and how many had the mesh of a neighbouring image.

    Args:
        name: of the case, for errors.
        samples: file of masks.
        cells, width, height: of the sheet and the images.
        far: how far away a neighbour may be.
        still: the mesh is that of phase 0 all the time.

    Raises:
        SystemExit: a mask is that of no mesh it could be of.
    """
    stored, tracer = np.load(samples), ShadowTracer(device="cpu")
    focal = FOCAL * width / WIDTH
    camera = Camera(width, height, focal, focal, width / 2, height / 2)
    known: dict[tuple[int, int], np.ndarray] = {}

    def of(phase: int, number: int) -> np.ndarray:
        key = phase, number % IMAGES
        if key not in known:
            tracer.scene.put("mesh", *sheet(cells, phase))
            depth = depth_image(number, width, height)
            known[key] = tracer.trace(depth, camera, [PointLight("lamp", LAMP)], bias=BIAS).mask()
        return known[key]

    neighbours = 0
    steps = sorted(range(-far, far + 1), key=lambda step: (abs(step), -step))
    for number, mask in zip(stored["numbers"].tolist(), stored["masks"], strict=True):
        shape = mask.reshape(height, width)
        for step in [0] if still else steps:
            if np.array_equal(shape, of(0 if still else (number + step) % PHASES, number)):
                neighbours += step != 0
                break
        else:
            of_any = [step for step in range(PHASES) if np.array_equal(shape, of((number - step) % PHASES, number))]
            whose = f"with the mesh of {of_any[0]} images before" if of_any and not still else "with no mesh there is"
            raise SystemExit(f"{name}: the mask of image {number} is not the library's; it would be {whose}")
    if not len(stored["masks"]):
        raise SystemExit(f"{name}: no mask to compare")
    return len(stored["masks"]), neighbours
