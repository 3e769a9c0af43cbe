# SPDX-License-Identifier: Apache-2.0
"""What the node hears of one camera: depth images, camera_info and poses, and what can be said about them."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from shadow_tracer.ros.cameras.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.cameras.rate_limit import RateLimit
from shadow_tracer.ros.diagnostics import Complaint, RateMeter
from shadow_tracer.ros.node import qos
from shadow_tracer.ros.node.transport import LossMeter
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire import compressed_depth
from shadow_tracer.ros.wire.messages import MessageError, camera_pose, decode_depth, in_unit, stamp_ns

if TYPE_CHECKING:
    from shadow_tracer.ros.node.inputs import Inputs

BACKWARD_STAMPS = 1_000_000_000  # images this much older than the last one mean a restarted bag, not a late message


class CameraInput:
    """The inputs of one camera.

    Args:
        name: its name; "" is the camera without one, whose topics have fixed names.
        inputs: those of the node, of which these are a part.

    Attributes:
        queue: images that wait.
        depth: meter of depth images, good or not.
        losses: gaps in their numbers.
        limit: which of them are wanted.
        refused: images and camera_info that cannot be used.
        format: encoding and size of the last good image.
        bytes: bytes of its pixels.
        frame: its optical frame, "" before there is one.
        last_stamp: its stamp [ns], 0 before there is one.
    """

    def __init__(self, name: str, inputs: Inputs) -> None:
        self.name = name
        self.queue = FrameQueue(name)
        self.depth = RateMeter()
        self.losses = LossMeter()
        self.limit = RateLimit()
        self.refused = Complaint()
        self.format = "-"
        self.bytes = 0
        self.frame = ""
        self.last_stamp = 0
        self._inputs = inputs
        self._transport = ""

    @property
    def settings(self) -> Settings:
        """The settings of the moment of this camera."""
        return self._inputs.settings().of(self.name)

    @property
    def listening(self) -> bool:
        """Whether it is subscribed to."""
        return bool(self._inputs.subscriptions)

    @property
    def best_effort(self) -> bool:
        """Whether lost images are not sent again."""
        return self._inputs.subscriptions[self.key("depth")].best_effort

    def key(self, what: str) -> str:
        """Name of one of its subscriptions, "depth", "info" or "pose", among all of the node."""
        return f"{what} {self.name}" if self.name else what

    def topic(self, what: str) -> str:
        """Resolved topic of one of its subscriptions."""
        return self._inputs.topic(self.key(what))

    def mismatch(self, *what: str) -> str:
        """Why a publisher of one of these cannot be heard; "" if all can."""
        return self._inputs.mismatch(*map(self.key, what))

    def subscribe(self) -> None:
        """Begin to listen."""
        _, info, pose = self._topics()
        self._subscribe_depth(self.settings.depth_image_transport)
        add, follow = self._inputs.add, {"reliability": True, "durability": True}
        read = reader(CameraInfo, self.refused, "camera_info", self._on_info)
        add(self.key("info"), CameraInfo, info, read, qos.newest_reliable(), **follow)
        read = reader(PoseStamped, self._inputs.pose_refused, pose, self._on_pose)
        add(self.key("pose"), PoseStamped, pose, read, qos.history_of_sensor())

    def configure(self, settings: Settings) -> None:
        """Follow new settings, which are those of this camera."""
        self.queue.every = settings.process == "every"
        self.limit.rate = settings.camera_rate
        subscriptions = self._inputs.subscriptions
        if not subscriptions:
            return
        if settings.depth_image_transport != self._transport:
            subscriptions.pop(self.key("depth")).close()
            self._subscribe_depth(settings.depth_image_transport)
        profile = qos.every_reliable() if self.queue.every else qos.newest_reliable()
        for what in ("depth", "info"):
            subscriptions[self.key(what)].ask(profile.depth)

    def restart(self) -> None:
        """Time has jumped: nothing that waits is of the present."""
        self.last_stamp = 0
        self.queue.clear()

    def _topics(self) -> tuple[str, str, str]:
        """Of depth image, camera_info and pose, before remapping."""
        for each in self.settings.cameras:
            if each.name == self.name:
                return each.depth_topic, each.info_topic, each.pose_topic
        return "depth/image_rect", "depth/camera_info", "camera_pose"

    def _subscribe_depth(self, transport: str) -> None:
        self._transport = transport
        self.losses = LossMeter()
        topic, kind = self._topics()[0], Image
        if transport != "raw":
            topic, kind = self._sibling(topic, transport), CompressedImage
        read = partial(self._read_depth, kind)
        self._inputs.add(self.key("depth"), kind, topic, read, qos.newest_reliable(), reliability=True)

    def _sibling(self, topic: str, transport: str) -> str:
        """Where image_transport publishes an image packed: beside its topic after remapping, if it is not remapped
        itself."""
        sibling = f"{topic}/{transport}"
        resolve = self._inputs.node.resolve_topic_name
        remapped = resolve(sibling) != resolve(sibling, only_expand=True)
        return str(resolve(sibling) if remapped else f"{resolve(topic)}/{transport}")

    def _read_depth(self, kind: Any, data: bytes, info: dict[str, Any]) -> None:
        now, number = time.monotonic(), info.get("publication_sequence_number") or 0
        alone = self._inputs.subscriptions[self.key("depth")].publisher_count == 1
        self.losses.note(number, now, alone)
        if not self.limit.wants(now):
            self.depth.tick(now)
            return
        start = time.perf_counter()
        reader(kind, self.refused, "image", partial(self._on_depth, start=start))(data)

    def _on_depth(self, msg: Image | CompressedImage, start: float) -> None:
        now, stamp, settings = time.monotonic(), stamp_ns(msg.header.stamp), self.settings
        self.depth.tick(now)
        try:
            image, depth = _unpacked(msg, settings)
        except MessageError as error:
            self.refused.add(str(error), now)
            return
        if stamp < self.last_stamp - BACKWARD_STAMPS:
            seconds = (self.last_stamp - stamp) * 1e-9
            self._inputs.note_jump(self, f"depth images start again {seconds:.1f} s earlier")
        self.last_stamp = stamp
        packed = "" if image is msg else f", {self._transport}"
        self.format = f"{image.encoding} {image.width} x {image.height}{packed}"
        self.bytes = len(msg.data)
        self.frame = settings.camera_frame or msg.header.frame_id
        # Frames that wait in line were taken before the meshes that come meanwhile.
        parts = self._inputs.meshes.store.snapshot() if self.queue.every else None
        decoding, topic = (time.perf_counter() - start) * 1e3, self.topic("depth")
        self.queue.put(WaitingFrame(image, depth, stamp, now, decoding, parts, topic))
        self._inputs.note_image(self)

    def _on_info(self, msg: CameraInfo) -> None:
        self.queue.put_info(msg)
        self._inputs.wake()

    def _on_pose(self, msg: PoseStamped) -> None:
        try:
            stamp, pose = camera_pose(msg, self.settings.fixed_frame)
        except MessageError as error:
            self._inputs.pose_refused.add(f"{self._topics()[2]}: {error}", time.monotonic())
            return
        self._inputs.frames.poses_of[self.name].add(stamp, pose)
        self._inputs.wake()


# Everything arrives as bytes: rclpy drops what it cannot read without a word, here it is counted and explained.


def reader(kind: Any, refused: Complaint, what: str, callback: Callable[[Any], None]) -> Callable[[bytes], None]:
    """A callback of bytes that passes the message on, or counts that it is none."""

    def read(data: bytes) -> None:
        try:
            message = deserialize_message(data, kind)
        except Exception as error:  # RMWError, UnicodeDecodeError, and what other middleware may raise
            refused.add(f"{what}: these {len(data)} bytes are no {kind.__name__}: {error}", time.monotonic())
            return
        callback(message)

    return read


def _unpacked(msg: Image | CompressedImage, settings: Settings) -> tuple[Image, Any]:
    """The image with its header, without pixels where it came packed; and its depth. Raises MessageError."""
    if isinstance(msg, Image):
        return msg, decode_depth(msg, settings.depth_unit)
    depth = in_unit(compressed_depth.decode(msg.format, msg.data, settings.max_rays), settings.depth_unit)
    encoding = msg.format.partition(";")[0].strip()
    return Image(header=msg.header, height=depth.shape[0], width=depth.shape[1], encoding=encoding), depth
