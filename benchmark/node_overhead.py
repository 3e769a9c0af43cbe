# SPDX-License-Identifier: Apache-2.0
"""What the node spends around the trace at 640 x 480 with a mesh that changes every frame, and on receiving the mesh.

Node and publisher run in one process, so the figures are the node's own and not the transport's; with ``--processes``
the node is a process of its own, as robots run it. The node's ``~/timing`` is what is read: the stages of the trace
itself (unproject, project, setup, build, trace, resolve) are left out of the overhead. Every mask is compared with the
library's answer for the same input before its frame counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "58")
os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp())

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from procedural import wavy_sheet
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from report import finish, summary
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

from shadow_tracer import Bias, Camera, PointLight, Scene, ShadowTracer
from shadow_tracer.ros.node.node import ShadowNode
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.world.frames import Frames, Tf2
from shadow_tracer.ros.world.mesh_sources import MeshSources

WIDTH, HEIGHT, FOCAL = 640, 480, 525.0
LAMP = (0.4, -0.3, 0.2)
BIAS = Bias(0.02, 0.003, 0.6)  # the node's default
_WARM_UP = 5


def info_msg(stamp: int, width: int = WIDTH, height: int = HEIGHT) -> CameraInfo:
    """camera_info at a stamp [ns]; the horizontal field of view is the same for every size."""
    focal = FOCAL * width / WIDTH
    info = CameraInfo(width=width, height=height)
    info.header.frame_id = "camera"
    info.header.stamp.sec, info.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    info.k = [focal, 0.0, width / 2, 0.0, focal, height / 2, 0.0, 0.0, 1.0]
    return info


def image_msg(depth: np.ndarray, stamp: int) -> Image:
    """A depth image of (H, W) uint16 millimetres at a stamp [ns]."""
    height, width = depth.shape
    image = Image(width=width, height=height, encoding="16UC1", step=2 * width)
    image.header = info_msg(stamp).header
    image.data.frombytes(memoryview(depth).cast("B"))
    return image


class Measurement:
    """Plays frames to the node and collects what it says about them."""

    def __init__(self, processes: bool) -> None:
        overrides = {"light_names": ["lamp"], "lights.lamp.position": list(LAMP), "pose_source": "parameter"}
        overrides |= {"bias.constant": BIAS.constant, "bias.quadratic": BIAS.quadratic}
        overrides |= {"bias.normal": BIAS.normal, "device": "cpu"}
        self.node: ShadowNode | None = None
        self.process: subprocess.Popen[bytes] | None = None
        if processes:
            # Behind a mesh of 1.7 MB stock Fast DDS delivers some camera_info seconds late, with its next heartbeat.
            overrides["camera_info_policy"] = "latest"
            overrides["qos_overrides./depth/image_rect.subscription.reliability"] = "reliable"
            arguments = [word for name, value in overrides.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
            command = [sys.executable, "-m", "shadow_tracer.ros", "--ros-args", *arguments]
            self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        else:
            parameters = [Parameter(name, value=value) for name, value in overrides.items()]
            self.node = ShadowNode(parameter_overrides=parameters)
        self.player = Node("player")
        reliable = QoSProfile(depth=1)
        self.depth_out = self.player.create_publisher(Image, "depth/image_rect", reliable)
        self.info_out = self.player.create_publisher(CameraInfo, "depth/camera_info", reliable)
        self.mesh_out = self.player.create_publisher(Mesh, "mesh", reliable)
        self.timing: DiagnosticArray | None = None
        self.mask: Image | None = None
        self.player.create_subscription(DiagnosticArray, "/shadow_tracer/timing", self._on_timing, reliable)
        self.player.create_subscription(Image, "/shadow_tracer/mask/lamp", self._on_mask, reliable)
        self.executor = SingleThreadedExecutor()
        if self.node is not None:
            self.executor.add_node(self.node)
        self.executor.add_node(self.player)

    def wait_until_ready(self) -> None:
        """Until the node traces what it is sent."""
        if self.node is not None:
            self.spin_until(lambda: self.node is not None and self.node.ready)
        else:
            outputs = (self.depth_out, self.info_out, self.mesh_out)
            self.spin_until(lambda: all(output.get_subscription_count() for output in outputs))

    def close(self) -> None:
        """End the node."""
        self.executor.shutdown()
        if self.node is not None:
            self.node.close()
        if self.process is not None:
            self.process.terminate()
            self.process.wait(30)
        self.player.destroy_node()

    def _on_timing(self, message: DiagnosticArray) -> None:
        self.timing = message

    def _on_mask(self, message: Image) -> None:
        self.mask = message

    def spin_until(self, done: object, seconds: float = 120.0) -> None:
        """Run callbacks until ``done()``."""
        assert callable(done)
        for _ in range(int(seconds / 0.01)):
            if done():
                return
            self.executor.spin_once(timeout_sec=0.01)
        raise TimeoutError("the node did not answer")

    def play(self, mesh: bytes, depth: np.ndarray, stamp: int) -> tuple[dict[str, float], np.ndarray]:
        """Publish one frame; returns the node's stages [ms] and its mask."""
        self.timing = self.mask = None
        self.mesh_out.publish(mesh)
        # Nothing tells from outside that the mesh is there; a mask of the old one would be noticed by the comparison.
        end = time.monotonic() + 0.1
        self.spin_until(lambda: time.monotonic() > end)
        self.info_out.publish(info_msg(stamp))
        self.depth_out.publish(image_msg(depth, stamp))
        self.spin_until(lambda: self.timing is not None and self.mask is not None)
        assert self.timing is not None and self.mask is not None
        stages = {}
        for item in self.timing.status[0].values:
            name, _, unit = item.key.partition(" [")
            if unit == "ms]":
                stages[name] = float(item.value)
        return stages, np.frombuffer(self.mask.data, np.uint8).reshape(HEIGHT, WIDTH)


def receive_mesh(cells: int, frames: int) -> dict[str, list[float]]:
    """Milliseconds of Python per received mesh: parsing, and giving it to the scene."""
    scene, inputs = Scene(), MeshSources(1_000_000, "elevation")
    settings = settings_from({})
    places = Frames(lambda: Tf2(None)).at(settings, "camera", 0)  # everything is in the camera's frame
    times: dict[str, list[float]] = {"new triangles": [], "same triangles, new positions": []}
    for frame in range(frames):
        vertices, triangles = wavy_sheet(cells, 0.1 * frame)
        for what, order in (("new triangles", triangles[::-1] if frame % 2 else triangles), ("same", None)):
            data = encode_mesh(vertices + 0.001, order if order is not None else triangles[:: -1 if frame % 2 else 1])
            begin = time.perf_counter()
            inputs.receive("mesh", data, 0.0, 0)
            inputs.store.update(scene, places, settings.mesh_frame)
            elapsed = (time.perf_counter() - begin) * 1e3
            times["new triangles" if what == "new triangles" else "same triangles, new positions"].append(elapsed)
    return times


def play(measurement: Measurement, frames: int, cells: int) -> dict[str, list[float]]:
    """Milliseconds per stage of ``frames`` frames whose masks are right; a few before them warm up."""
    tracer = ShadowTracer(device="cpu")
    camera = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    generator = np.random.default_rng(0)
    collected: dict[str, list[float]] = {}
    latest: np.ndarray | None = None
    late = 0
    for frame in range(frames + _WARM_UP):
        vertices, triangles = wavy_sheet(cells, 0.1 * frame)
        # Noise as of a camera: of the same image the node would use samples and rays again.
        depth = (2500 + generator.integers(-1, 2, (HEIGHT, WIDTH))).astype(np.uint16)
        depth[::37, ::41] = 0
        stages, mask = measurement.play(encode_mesh(vertices, triangles), depth, (frame + 1) * 33_000_000)
        before, latest = latest, vertices
        if frame < _WARM_UP:
            continue

        def right(positions: np.ndarray, mesh: np.ndarray = triangles, image: np.ndarray = depth) -> np.ndarray:
            tracer.scene.put("mesh", positions, mesh)
            return tracer.trace(image, camera, [PointLight("lamp", LAMP)], bias=BIAS).mask("lamp")

        expected = right(vertices)
        if not np.array_equal(mask, expected):
            if before is not None and np.array_equal(mask, right(before)):
                late += 1  # the mesh came after its image, which reliable topics do not exclude: not the frame meant
                continue
            wrong = int((mask != expected).sum())
            said = measurement.timing.status[0].message if measurement.timing else "nothing"
            raise SystemExit(
                f"frame {frame}: the node's mask differs from the library's in {wrong} pixels; the node says: {said}"
            )
        overhead = sum(stages[name] for name in stages if name in ("decode", "transforms", "masks", "publish"))
        overhead += stages["mesh"] + stages["trace.upload"] + stages["trace.download"]
        for name, value in (stages | {"OVERHEAD (decode, mesh, upload, download, masks, publish)": overhead}).items():
            collected.setdefault(name, []).append(value)
    if late:
        print(
            f"{late} frames left out: their mesh came after their image, and their masks are right for the one before"
        )
    return collected


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--cells", type=int, default=187, help="the sheet has 2 * cells^2 triangles")
    parser.add_argument("--json", help="file to write")
    parser.add_argument("--processes", action="store_true", help="run the node as a process of its own")
    options = parser.parse_args()
    rclpy.init()
    measurement = Measurement(options.processes)
    try:
        measurement.wait_until_ready()
        collected = play(measurement, options.frames, options.cells)
    finally:
        measurement.close()
        rclpy.try_shutdown()
    rows = [{"what": f"{name} [ms]", **summary(values)} for name, values in collected.items()]
    for what, values in receive_mesh(options.cells, options.frames).items():
        rows.append({"what": f"RECEIVE a mesh, {what} [ms]", **summary(values)})
    where = "two processes" if options.processes else "one process"
    title = f"Node at {WIDTH} x {HEIGHT}, {2 * options.cells**2} triangles changing every frame, {where}"
    finish(title, rows, options.json)


if __name__ == "__main__":
    main()
