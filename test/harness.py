# SPDX-License-Identifier: Apache-2.0
"""Runs the node without launch: in this process, spun until something is true, or as a process of its own.

Nothing here sleeps for a fixed time; what does not happen within the timeout fails with a sentence.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

import shadow_tracer
from shadow_tracer.ros.cdr import encode_mesh
from shadow_tracer.ros.node import ShadowNode

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
TIMEOUT = 20.0

# Small buffers: a node of a test is made in milliseconds.
SMALL = {
    "device": "cpu",
    "bounds.max_triangles": 4096,
    "bounds.max_rays": 128 * 96,
    "bounds.queue_capacity": 16384,
    "diagnostics_period": 0.1,
}


def reliable(depth: int = 10, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    """A reliable profile that keeps the last few."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


def time_msg(nanoseconds: int) -> Time:
    """A stamp as a message."""
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def nanoseconds(stamp: Time) -> int:
    """A stamp as one number."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def wall(width: int = WIDTH, height: int = HEIGHT, distance: float = 2.0) -> np.ndarray:
    """Depth of a wall across the optical axis, (H, W) float32 metres, with one invalid pixel in the corner."""
    depth = np.full((height, width), distance, np.float32)
    depth[0, 0] = np.nan
    return depth


def plate(distance: float = 1.0, half: float = 0.25, x: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A square plate across the optical axis: (4, 3) vertices and (2, 3) triangles."""
    corners = [(x - half, -half), (x + half, -half), (x + half, half), (x - half, half)]
    return np.array([(u, v, distance) for u, v in corners]), np.array([(0, 1, 2), (0, 2, 3)])


def image_msg(depth: np.ndarray, stamp: int, frame: str = "camera", encoding: str = "") -> Image:
    """A depth image message of an array, float32 metres or uint16 millimetres."""
    msg = Image(height=depth.shape[0], width=depth.shape[1], step=depth.shape[1] * depth.itemsize)
    msg.encoding = encoding or {"float32": "32FC1", "uint16": "16UC1"}[depth.dtype.name]
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    msg.data.frombytes(np.ascontiguousarray(depth).tobytes())
    return msg


def info_msg(width: int, height: int, stamp: int, focal: float = FOCAL, frame: str = "camera") -> CameraInfo:
    """A camera_info message of an ideal camera."""
    msg = CameraInfo(width=width, height=height, distortion_model="plumb_bob", d=[0.0] * 5)
    cx, cy = (width - 1) / 2, (height - 1) / 2
    msg.k = [focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0]
    msg.p = [focal, 0.0, cx, 0.0, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    return msg


class Rig:
    """A node and a friend that talks to it, in one context of their own. Use as a context manager.

    Args:
        parameters: overrides of the node, on top of :data:`SMALL`.
        start: make the node at once; otherwise :meth:`start` does it later.
        arguments: further ROS arguments of the node, such as remappings.
        latched: publish meshes transient local.
        namespace: namespace of the friend, for a node in another process that has one.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        latched: bool = False,
        namespace: str = "",
        start: bool = True,
    ) -> None:
        self.context = Context()
        rclpy.init(context=self.context, args=[])
        self.executor = SingleThreadedExecutor(context=self.context)
        self.friend = Node("friend", context=self.context, namespace=namespace)
        self.executor.add_node(self.friend)
        self.node: ShadowNode | None = None
        self.stamp = 1_000_000_000_000
        mesh_qos = reliable(1, DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)
        self.depth = self.friend.create_publisher(Image, "depth/image_rect", reliable())
        self.info = self.friend.create_publisher(CameraInfo, "depth/camera_info", reliable())
        self.mesh = self.friend.create_publisher(Mesh, "mesh", mesh_qos)
        self.pose = self.friend.create_publisher(PoseStamped, "camera_pose", reliable())
        self.masks: dict[str, list[Image]] = {}
        self.reports: list[DiagnosticArray] = []
        self.timings: list[DiagnosticArray] = []
        self.infos: list[CameraInfo] = []
        self.listen(Image, "shadow_tracer/mask", self.masks.setdefault("", []))
        self.listen(DiagnosticArray, "/diagnostics", self.reports)
        self.listen(DiagnosticArray, "shadow_tracer/timing", self.timings)
        self.listen(CameraInfo, "shadow_tracer/camera_info", self.infos)
        if start:
            self.start(parameters, arguments)

    def start(self, parameters: Mapping[str, Any] | None = None, arguments: Sequence[str] = ()) -> ShadowNode:
        """Make the node and wait until it traces and everybody hears everybody."""
        overrides = [Parameter(name, value=value) for name, value in {**SMALL, **(parameters or {})}.items()]
        cli = ["--ros-args", *arguments] if arguments else None
        self.node = node = ShadowNode(context=self.context, parameter_overrides=overrides, cli_args=cli)
        self.executor.add_node(node)
        self.until(lambda: node.ready, 120.0, "the node is ready")
        self.connected()
        return node

    def connected(self, timeout: float = TIMEOUT) -> None:
        """Wait until the node's inputs and outputs are matched."""
        publishers = (self.depth, self.info, self.mesh, self.pose)
        self.until(lambda: all(p.get_subscription_count() for p in publishers), timeout, "the node subscribes")
        topics = [self.friend.resolve_topic_name(f"shadow_tracer/{name}") for name in ("mask", "timing", "camera_info")]
        self.until(lambda: all(self.friend.count_publishers(t) for t in topics), timeout, "the node publishes")
        heard = {s.topic_name: s for s in self.friend.subscriptions}
        self.until(lambda: all(heard[t].get_publisher_count() for t in topics), timeout, "the node is heard")

    def listen(self, kind: Any, topic: str, into: list[Any]) -> None:
        """Collect the messages of a topic in a list."""
        self.friend.create_subscription(kind, topic, into.append, reliable(50))

    def listen_to_light(self, name: str) -> list[Image]:
        """Collect the masks of one light."""
        into: list[Image] = self.masks.setdefault(name, [])
        topic = f"shadow_tracer/mask/{name}"
        self.listen(Image, topic, into)
        subscription = list(self.friend.subscriptions)[-1]
        self.until(lambda: subscription.get_publisher_count() > 0, TIMEOUT, f"{topic} is published")
        return into

    def until(self, predicate: Callable[[], Any], timeout: float = TIMEOUT, what: str = "the expected") -> Any:
        """Spin until the predicate is true and return its value; fail after ``timeout`` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            value = predicate()
            if value:
                return value
            if time.monotonic() > deadline:
                raise AssertionError(f"not within {timeout:g} s: {what}; {self.last_statuses()}")
            self.executor.spin_once(timeout_sec=0.02)

    def settle(self, seconds: float = 0.3) -> None:
        """Spin on, to see that something does not happen."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.02)

    def next_stamp(self, step: int = 33_000_000) -> int:
        """A stamp later than those before [ns]."""
        self.stamp += step
        return self.stamp

    def send_mesh(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        """Publish a mesh and wait until the node has it."""
        self.send_mesh_bytes(encode_mesh(vertices, triangles))

    def send_mesh_bytes(self, data: bytes) -> None:
        """Publish any bytes as a mesh and wait until the node has them."""
        if self.node is None:
            self.mesh.publish(data)
            return
        before = self.value("input mesh", "received")
        self.mesh.publish(data)
        self.until(lambda: self.value("input mesh", "received") != before, what="the mesh is received")

    def send_frame(
        self, depth: np.ndarray, stamp: int | None = None, *, info: bool = True, frame: str = "camera"
    ) -> int:
        """Publish a depth image and its camera_info. Returns the stamp [ns]."""
        stamp = self.next_stamp() if stamp is None else stamp
        if info:
            self.info.publish(info_msg(depth.shape[1], depth.shape[0], stamp, frame=frame))
        self.depth.publish(image_msg(depth, stamp, frame))
        return stamp

    def mask_of(self, stamp: int, light: str = "", timeout: float = TIMEOUT) -> np.ndarray:
        """Wait for the mask with this stamp; (H, W) uint8."""

        def found() -> Image | None:
            return next((m for m in self.masks[light] if nanoseconds(m.header.stamp) == stamp), None)

        msg = self.until(found, timeout, f"a mask with stamp {stamp}")
        assert (msg.encoding, msg.step, msg.header.frame_id) == ("mono8", msg.width, "camera")
        return np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.width)

    def trace(self, depth: np.ndarray, **keywords: Any) -> np.ndarray:
        """Publish a frame and wait for its mask."""
        return self.mask_of(self.send_frame(depth, **keywords))

    def set(self, **values: Any) -> str:
        """Set parameters of the node in one go, ``__`` standing for a dot; "" or why it was refused."""
        assert self.node is not None
        changes = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        result = self.node.set_parameters_atomically(changes)
        return "" if result.successful else result.reason

    def status(self, name: str) -> DiagnosticStatus | None:
        """The last status of that name on /diagnostics."""
        return (
            next((s for s in self.reports[-1].status if s.name.endswith(f": {name}")), None) if self.reports else None
        )

    def value(self, status: str, key: str) -> str:
        """A value of the last status of that name, "" if there is none."""
        found = self.status(status)
        return next((pair.value for pair in found.values if pair.key == key), "") if found else ""

    def wait_status(self, name: str, level: bytes, text: str = "", timeout: float = TIMEOUT) -> DiagnosticStatus:
        """Wait until a status has this level and contains this text."""

        def found() -> DiagnosticStatus | None:
            status = self.status(name)
            return status if status is not None and status.level == level and text in status.message else None

        return self.until(found, timeout, f"{name} says {level!r} {text!r}")

    def last_statuses(self) -> str:
        """The last diagnostics in words, for messages of failed tests."""
        if not self.reports:
            return "no diagnostics"
        return "; ".join(f"{s.name} {s.level!r} {s.message}" for s in self.reports[-1].status)

    def publish_clock(self, seconds: float) -> None:
        """Publish sim time."""
        if not hasattr(self, "_clock"):
            self._clock = self.friend.create_publisher(Clock, "/clock", reliable())
            self.until(lambda: self._clock.get_subscription_count(), what="somebody listens to /clock")
        self._clock.publish(Clock(clock=time_msg(int(seconds * 1e9))))

    def close(self) -> None:
        """Destroy everything in the order that leaves nothing behind."""
        self.executor.shutdown(timeout_sec=0.0)
        if self.node is not None:
            assert self.node.close(60.0)
        self.friend.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class NodeProcess:
    """The program ``shadow_node`` as a process of its own. Use as a context manager.

    Args:
        parameters: overrides, on top of :data:`SMALL`.
        environment: further environment variables.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        values = {**SMALL, **(parameters or {})}
        flags = [part for name, value in values.items() for part in ("-p", f"{name}:={_yaml(value)}")]
        root = str(Path(shadow_tracer.__file__).parents[1])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH", ""))))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "shadow_tracer.ros", "--ros-args", *flags, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path, **(environment or {})},
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=(stream, into), daemon=True)
            for stream, into in ((self._process.stdout, self.out), (self._process.stderr, self.err))
        ]
        for reader in self._readers:
            reader.start()

    @staticmethod
    def _read(stream: Any, into: list[str]) -> None:
        for line in stream:
            into.append(line)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """True until the process has ended."""
        return self._process.poll() is None

    def wait_for(self, text: str, timeout: float = 120.0) -> None:
        """Wait until a line of stdout contains the text."""
        deadline = time.monotonic() + timeout
        while not any(text in line for line in list(self.out)):
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(f"no line with {text!r}: {self.out} {self.err}")
            self._readers[0].join(0.02)

    def stop(self, number: signal.Signals, timeout: float = 30.0) -> tuple[int, str]:
        """Send a signal; returns the exit code and everything on stderr."""
        self.send(number)
        return self.wait(timeout)

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self, timeout: float = 60.0) -> tuple[int, str]:
        """Wait for the end; returns the exit code and everything on stderr."""
        code = self._process.wait(timeout)
        for reader in self._readers:
            reader.join(5.0)
        return code, "".join(self.err)

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
