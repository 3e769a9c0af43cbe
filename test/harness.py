# SPDX-License-Identifier: Apache-2.0
"""Runs the node without launch: in this process, spun until something is true, or as a process of its own.

Nothing here sleeps for a fixed time; what does not happen within the timeout fails with a sentence.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from compressed_images import compressed_msg
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from node_process import SMALL
from node_process import NodeProcess as NodeProcess  # for those who import it from here
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from shape_msgs.msg import Mesh

from shadow_tracer.ros.cdr import encode_mesh
from shadow_tracer.ros.core import Core
from shadow_tracer.ros.node import ShadowNode

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
TIMEOUT = 20.0


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
        codec: png or rvl: depth images are sent packed, as compressedDepth.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        latched: bool = False,
        namespace: str = "",
        codec: str = "",
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
        self.codec = codec
        kind, topic = (CompressedImage, "/compressedDepth") if codec else (Image, "")
        self.depth = self.friend.create_publisher(kind, f"depth/image_rect{topic}", reliable())
        self.info = self.friend.create_publisher(CameraInfo, "depth/camera_info", reliable())
        self.mesh = self.friend.create_publisher(Mesh, "mesh", mesh_qos)
        self.pose = self.friend.create_publisher(PoseStamped, "camera_pose", reliable())
        self.masks: dict[str, list[Image]] = {}
        self.reports: list[DiagnosticArray] = []
        self.timings: list[DiagnosticArray] = []
        self.infos: list[CameraInfo] = []
        self._publishers: dict[Any, Publisher] = {}
        self._collected: dict[str, list[Any]] = {}
        self._clients: dict[str, Any] = {}
        self.listen(Image, "shadow_tracer/mask", self.masks.setdefault("", []))
        self.listen(DiagnosticArray, "/diagnostics", self.reports)
        self.listen(DiagnosticArray, "shadow_tracer/timing", self.timings)
        self.listen(CameraInfo, "shadow_tracer/camera_info", self.infos)
        if start:
            self.start(parameters, arguments)

    def start(
        self,
        parameters: Mapping[str, Any] | None = None,
        arguments: Sequence[str] = (),
        *,
        kind: Callable[..., Any] = ShadowNode,
        wait: bool = True,
    ) -> Any:
        """Make the node, and wait until it traces and everybody hears everybody.

        Args:
            kind: its class.
            wait: False: return at once.
        """
        overrides = [Parameter(name, value=value) for name, value in {**SMALL, **(parameters or {})}.items()]
        cli = ["--ros-args", *arguments] if arguments else None
        self.node = node = kind(context=self.context, parameter_overrides=overrides, cli_args=cli)
        self.executor.add_node(node)
        if wait:
            self.until(lambda: node.ready, 120.0, "the node is ready")
            self.connected()
        return node

    @property
    def core(self) -> Core:
        """What is behind the node, for tests that look at what no topic tells."""
        assert self.node is not None
        return self.node.core

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

    def publisher(self, kind: Any, topic: str, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> Publisher:
        """A reliable publisher that somebody listens to, made at the first call."""
        key = (topic, durability)
        if key not in self._publishers:
            self._publishers[key] = self.friend.create_publisher(kind, topic, reliable(50, durability))
        made = self._publishers[key]
        self.until(lambda: made.get_subscription_count() > 0, what=f"somebody listens to {topic}")
        return made

    def collect(self, kind: Any, topic: str) -> list[Any]:
        """Collect the messages of a topic in a list, which is the same for the same topic."""
        if topic not in self._collected:
            self.listen(kind, topic, self._collected.setdefault(topic, []))
            subscription = list(self.friend.subscriptions)[-1]
            self.until(lambda: subscription.get_publisher_count() > 0, what=f"{topic} is published")
        return self._collected[topic]

    def send_part(self, topic: str, kind: Any, message: Any) -> None:
        """Publish a mesh on one of its topics, as a message or as bytes, and wait until the node has taken it."""
        source = self.core.inputs.meshes.sources[topic]
        publisher, before = self.publisher(kind, topic), source.arrivals.count
        publisher.publish(message)
        self.until(lambda: source.arrivals.count > before, what=f"{topic} is received")

    def ask(self, cloud: PointCloud2, timeout: float = TIMEOUT) -> PointCloud2:
        """Publish a query and wait for its answer."""
        answers = self.collect(PointCloud2, "shadow_tracer/query/visibility")
        publisher, before = self.publisher(PointCloud2, "query"), len(answers)
        publisher.publish(cloud)
        self.until(lambda: len(answers) > before, timeout, "the query is answered")
        return answers[-1]

    def request(self, kind: Any, service: str, request: Any = None) -> Any:
        """Call a service; the future of its response."""
        if service not in self._clients:
            self._clients[service] = self.friend.create_client(kind, service)
        client = self._clients[service]
        self.until(
            client.service_is_ready, 3 * TIMEOUT, f"{service} is there"
        )  # discovery can take long on a busy host
        return client.call_async(kind.Request() if request is None else request)

    def call(self, kind: Any, service: str, request: Any = None, timeout: float = TIMEOUT) -> Any:
        """Call a service and wait for its response."""
        future = self.request(kind, service, request)
        self.until(future.done, timeout, f"{service} answers")
        return future.result()

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
        before = self.value("input mesh", "received") or "0"  # before the first report
        self.mesh.publish(data)
        self.until(lambda: self.value("input mesh", "received") not in ("", before), what="the mesh is received")

    def send_frame(
        self, depth: np.ndarray, stamp: int | None = None, *, info: bool = True, frame: str = "camera"
    ) -> int:
        """Publish a depth image and its camera_info. Returns the stamp [ns]."""
        stamp = self.next_stamp() if stamp is None else stamp
        if info:
            self.info.publish(info_msg(depth.shape[1], depth.shape[0], stamp, frame=frame))
        self.depth.publish(self.depth_msg(depth, stamp, frame))
        return stamp

    def depth_msg(self, depth: np.ndarray, stamp: int, frame: str = "camera") -> Image | CompressedImage:
        """A depth image as it is sent now, packed or not."""
        return compressed_msg(depth, stamp, frame, self.codec) if self.codec else image_msg(depth, stamp, frame)

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
