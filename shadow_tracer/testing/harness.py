# SPDX-License-Identifier: Apache-2.0
"""A node to test against, without launch: in this process, spun until something is true, or as a separate one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh

from shadow_tracer.ros.diagnostics import MESH
from shadow_tracer.ros.node.node import NAME, ShadowNode, ShadowNodeMixin
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.scene.camera import Camera
from shadow_tracer.testing.friend import TIMEOUT, Friend
from shadow_tracer.testing.messages import (
    CAMERA_FRAME,
    camera_info_msg,
    image_msg,
    info_msg,
    nanoseconds,
    pose_msg,
    reliable,
    time_msg,
)
from shadow_tracer.testing.process import DEFAULTS, NodeProcess, NotInTime

START_TIMEOUT = 300.0  # the first start on a machine compiles kernels
FRAME_STEP = 33_000_000  # ns


class Harness(Friend):
    """A node and what talks to it, in a private domain. Use as a context manager.

    Nothing here runs in a thread: callbacks of the node (if it is in this process), of nodes given to ``add`` and of
    subscriptions run while a method waits. What does not come in time raises :class:`NotInTime`.

    Args:
        parameters: of the node, name -> value, on top of :data:`DEFAULTS`.
        arguments: further ROS arguments of the node, such as ``["-r", "mesh:=other"]``.
        namespace: of the node, and of what talks to it.
        process: run the node as a separate process, as ``shadow_node``.
        latched: publish meshes transient local, so that a node that starts later gets the last one.
        start: start the node, and wait until it traces; otherwise :meth:`start` does it later, or nobody.
        domain: as for :func:`isolated`.

    Attributes:
        defaults: :data:`DEFAULTS`; a subclass may have others.
        node: the node under test if it runs in this process. ``process``: the one that runs in another.
        stamp: that of the last frame [ns].
        masks: masks heard so far, by the name of the light, "" for that of all lights.
        reports, timings, infos: messages heard so far on ``/diagnostics``, ``~/timing`` and ``~/camera_info``.
    """

    defaults: Mapping[str, Any] = DEFAULTS

    def __init__(
        self,
        parameters: Mapping[str, Any] | None = None,
        *,
        arguments: Sequence[str] = (),
        namespace: str = "",
        process: bool = False,
        latched: bool = False,
        start: bool = True,
        domain: int | None = None,
    ) -> None:
        super().__init__(namespace, domain)
        self.node: ShadowNodeMixin | None = None
        self.process: NodeProcess | None = None
        self._given = dict(parameters or {}), tuple(arguments)
        self._separate = process
        self._named = False
        self._namespace = namespace
        self.stamp = 1_000_000_000_000
        try:
            self._connect(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)
            if start:
                self.start()
        except BaseException:
            self.close()
            raise

    def _connect(self, durability: DurabilityPolicy) -> None:
        self.depth = self.friend.create_publisher(Image, "depth/image_rect", reliable())
        self.info = self.friend.create_publisher(CameraInfo, "depth/camera_info", reliable())
        self.mesh = self.friend.create_publisher(Mesh, "mesh", reliable(1, durability))
        self.pose = self.friend.create_publisher(PoseStamped, "camera_pose", reliable())
        self.masks: dict[str, list[Image]] = {"": []}
        self.reports: list[DiagnosticArray] = []
        self.timings: list[DiagnosticArray] = []
        self.infos: list[CameraInfo] = []
        self.listen(Image, f"{NAME}/mask", self.masks[""])
        self.listen(DiagnosticArray, "/diagnostics", self.reports)
        self.listen(DiagnosticArray, f"{NAME}/timing", self.timings)
        self.listen(CameraInfo, f"{NAME}/camera_info", self.infos)

    def start(
        self,
        parameters: Mapping[str, Any] | None = None,
        arguments: Sequence[str] = (),
        *,
        kind: Callable[..., Any] = ShadowNode,
        wait: bool = True,
        timeout: float = START_TIMEOUT,
    ) -> Any:
        """Start the node, and wait until it traces and is connected.

        Args:
            parameters, arguments: on top of those given to the class.
            kind: class of a node in this process.
            wait: False: return at once.
            timeout: seconds to wait.

        Returns:
            The node, or its :class:`NodeProcess`.
        """
        if self.node is not None or self.process is not None:
            raise RuntimeError("start: the node has been started already")
        values = {**self.defaults, **self._given[0], **(parameters or {})}
        self._named = any(values.get("camera_names", ()))
        arguments = [*self._given[1], *arguments]
        if self._separate:
            space = ["-r", f"__ns:=/{self._namespace.strip('/')}"] if self._namespace else []
            self.process = NodeProcess(values, arguments=[*space, *arguments])
            self._left.callback(self.process.close)
            if wait:
                self.process.wait_for("Ready", timeout)
                self.connected()
            return self.process
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        cli = ["--ros-args", *arguments] if arguments else None
        self.node = node = kind(
            context=self.context, parameter_overrides=overrides, cli_args=cli, namespace=self._namespace or None
        )
        self._left.callback(_close_node, node)
        self._named = bool(node.settings.cameras)
        self.executor.add_node(node)
        if wait:
            self.until(lambda: node.ready, timeout, "the node is ready")
            self.connected()
        return node

    def connected(self, timeout: float = TIMEOUT) -> None:
        """Wait until the node's inputs and outputs are matched; those of cameras with names are not looked at."""
        publishers = (self.mesh,) if self._named else (self.depth, self.info, self.mesh, self.pose)
        self.until(lambda: all(p.get_subscription_count() for p in publishers), timeout, "the node subscribes")
        if self._named:
            return
        topics = [self.friend.resolve_topic_name(f"{NAME}/{name}") for name in ("mask", "timing", "camera_info")]
        self.until(lambda: all(self.friend.count_publishers(t) for t in topics), timeout, "the node publishes")
        heard = {s.topic_name: s for s in self.friend.subscriptions}
        self.until(lambda: all(heard[t].get_publisher_count() for t in topics), timeout, "the node is heard")

    def set_parameters(self, values: Mapping[str, Any], timeout: float = TIMEOUT) -> str:
        """Set parameters of the node, all or none; "" or why it was refused."""
        changes = [Parameter(name, value=value) for name, value in values.items()]
        if self.node is not None:
            result = self.node.set_parameters_atomically(changes)
        else:
            request = SetParametersAtomically.Request(parameters=[change.to_parameter_msg() for change in changes])
            result = self.call(SetParametersAtomically, f"{NAME}/set_parameters_atomically", request, timeout).result
        return "" if result.successful else str(result.reason)

    # What goes in

    def next_stamp(self, step: int = FRAME_STEP) -> int:
        """A stamp later than those before [ns]; they begin at 1000 s."""
        self.stamp += step
        return self.stamp

    def send_frame(
        self,
        depth: npt.NDArray[Any],
        stamp: int | None = None,
        *,
        camera: Camera | None = None,
        info: bool = True,
        frame: str = CAMERA_FRAME,
    ) -> int:
        """Publish a depth image and its camera_info.

        Args:
            depth: (H, W) float32 metres or uint16 millimetres.
            stamp: nanoseconds; None for :meth:`next_stamp`.
            camera: its intrinsics; None for those of :func:`info_msg`.
            info: False: the image alone.
            frame: of the header.

        Returns:
            The stamp [ns].
        """
        if camera is not None and depth.shape != (camera.height, camera.width):
            raise ValueError(f"depth: expected shape {(camera.height, camera.width)} of the camera, got {depth.shape}")
        stamp = self.next_stamp() if stamp is None else stamp
        image = self.depth_msg(depth, stamp, frame)
        if info and camera is None:
            self.info.publish(info_msg(depth.shape[1], depth.shape[0], stamp, frame=frame))
        elif info and camera is not None:
            self.info.publish(camera_info_msg(camera, stamp, frame))
        self.depth.publish(image)
        return stamp

    def depth_msg(self, depth: npt.NDArray[Any], stamp: int, frame: str = CAMERA_FRAME) -> Any:
        """A depth image as :meth:`send_frame` publishes it."""
        return image_msg(depth, stamp, frame)

    def send_mesh(self, vertices: npt.ArrayLike, triangles: npt.ArrayLike, timeout: float = TIMEOUT) -> None:
        """Publish (V, 3) vertices [m] and (T, 3) triangles as the mesh, and wait until the node has received it."""
        self.send_mesh_bytes(encode_mesh(vertices, triangles), timeout)

    def send_mesh_bytes(self, data: bytes, timeout: float = TIMEOUT) -> None:
        """Publish any bytes as the mesh, and wait until the node has received them; it may refuse them."""
        before = self.until(lambda: self.value(MESH, "received"), timeout, "the node's diagnostics")
        self.mesh.publish(data)
        self.until(lambda: self.value(MESH, "received") != before, timeout, "the mesh is received")

    def send_pose(
        self, position: Sequence[float], rotation: Sequence[float] = (0.0, 0.0, 0.0, 1.0), *, frame: str = ""
    ) -> None:
        """Publish the camera's pose (position [m], quaternion x y z w) with the stamp of the next frame; the node
        takes it where ``pose_source`` is ``topic``."""
        self.pose.publish(pose_msg(position, rotation, frame, self.stamp + FRAME_STEP))

    def send_light_pose(
        self, light: str, position: Sequence[float], rotation: Sequence[float] = (0.0, 0.0, 0.0, 1.0), frame: str = ""
    ) -> None:
        """Move a light: position [m], quaternion x y z w; it shines along +x of the pose."""
        self.publisher(PoseStamped, f"{NAME}/lights/{light}/pose").publish(pose_msg(position, rotation, frame))

    def publish_clock(self, seconds: float) -> None:
        """Publish sim time."""
        self.publisher(Clock, "/clock").publish(Clock(clock=time_msg(int(seconds * 1e9))))

    # What comes out

    def mask_msg(self, stamp: int, light: str = "", timeout: float = TIMEOUT) -> Image:
        """Wait for the mask with this stamp [ns].

        Args:
            light: a name that :meth:`listen_to_light` was called with; "" for the mask of all lights.
        """
        if light not in self.masks:
            raise ValueError(f"light: expected one of {list(self.masks)} (see listen_to_light), got {light!r}")

        def found() -> Image | None:
            return next((m for m in self.masks[light] if nanoseconds(m.header.stamp) == stamp), None)

        return self.until(found, timeout, f"a mask{f' of {light}' if light else ''} with stamp {stamp} ns")

    def mask_of(self, stamp: int, light: str = "", timeout: float = TIMEOUT) -> npt.NDArray[np.uint8]:
        """Wait for the mask with this stamp [ns], as :meth:`mask_msg`; (H, W) uint8."""
        msg = self.mask_msg(stamp, light, timeout)
        assert (msg.encoding, msg.step) == ("mono8", msg.width), f"{msg.encoding} with rows of {msg.step} bytes"
        return np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.width)

    def trace(self, depth: npt.NDArray[Any], **keywords: Any) -> npt.NDArray[np.uint8]:
        """Publish a frame, with the keywords of :meth:`send_frame`, and wait for its mask."""
        return self.mask_of(self.send_frame(depth, **keywords))

    def timing_of(self, stamp: int, timeout: float = TIMEOUT) -> dict[str, str]:
        """Wait for the timing of the frame with this stamp [ns]: what ``~/timing`` says, key -> value."""

        def found() -> DiagnosticArray | None:
            return next((m for m in self.timings if nanoseconds(m.header.stamp) == stamp), None)

        msg = self.until(found, timeout, f"the timing of stamp {stamp} ns")
        return {pair.key: pair.value for pair in msg.status[0].values}

    def listen_to_light(self, name: str, timeout: float = TIMEOUT) -> list[Image]:
        """The list of all masks of one light from the first call on, which waits until the node publishes them."""
        if name not in self.masks:
            self.masks[name] = self.collect(Image, f"{NAME}/mask/{name}", timeout)
        return self.masks[name]

    def status(self, name: str) -> DiagnosticStatus | None:
        """The last status of that name, such as ``input depth``, that the node has published on /diagnostics."""
        return next((s for s in self._last_report() if s.name.endswith(f": {name}")), None)

    def value(self, status: str, key: str) -> str:
        """A value of the last status of that name, "" if there is none."""
        found = self.status(status)
        return next((pair.value for pair in found.values if pair.key == key), "") if found else ""

    def wait_status(self, name: str, level: bytes, text: str = "", timeout: float = TIMEOUT) -> DiagnosticStatus:
        """Wait until a status has this level, such as ``DiagnosticStatus.WARN``, and contains this text."""

        def found() -> DiagnosticStatus | None:
            status = self.status(name)
            return status if status is not None and status.level == level and text in status.message else None

        return self.until(found, timeout, f"{name} says {level!r} {text!r}")

    def last_statuses(self) -> str:
        """The node's last diagnostics in words."""
        said = "; ".join(f"{s.name} {s.level!r} {s.message}" for s in self._last_report())
        return said or "no diagnostics"

    def _last_report(self) -> list[DiagnosticStatus]:
        """The statuses of the last report of the node; others publish on /diagnostics too."""
        names = f"{self.friend.get_namespace().strip('/')}/{NAME}: ".lstrip("/")
        own = ([s for s in report.status if s.name.startswith(names)] for report in reversed(self.reports))
        return next((statuses for statuses in own if statuses), [])

    def heard(self) -> str:
        """What came last, in words."""
        said = []
        for light, masks in self.masks.items():
            name = f" of {light}" if light else ""
            last = f", the last with stamp {nanoseconds(masks[-1].header.stamp)} ns" if masks else ""
            said.append(f"{len(masks)} masks{name}{last}")
        return "; ".join(part for part in (*said, super().heard(), self.last_statuses()) if part)

    def forget(self) -> None:
        """Drop all masks, reports, timings and camera_infos heard so far."""
        for messages in (*self.masks.values(), self.reports, self.timings, self.infos):
            messages.clear()

    def _check(self, what: str) -> None:
        if self.process is not None and self.process.failed:
            raise NotInTime(f"the node ended before {what}; {self.process.said()}")


def _close_node(node: ShadowNodeMixin) -> None:
    if not node.close(60.0):
        raise NotInTime("not within 60 s: the end of the thread of the node's tracer, which still compiles")
