# SPDX-License-Identifier: Apache-2.0
"""What the node subscribes to. Callbacks check and store; the work is done in one step afterwards."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker, MarkerArray

from shadow_tracer.ros.cameras.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.diagnostics import Complaint, RateMeter
from shadow_tracer.ros.node import qos
from shadow_tracer.ros.node.queries import Queries
from shadow_tracer.ros.node.subscriptions import AbsentSubscription, FollowingSubscription
from shadow_tracer.ros.node.transport import LossMeter
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire import compressed_depth
from shadow_tracer.ros.wire.layouts import grid_map_type
from shadow_tracer.ros.wire.messages import MessageError, camera_pose, decode_depth, in_unit, pose_matrix, stamp_ns
from shadow_tracer.ros.world.frames import Frames
from shadow_tracer.ros.world.lighting import Lighting, LightPose
from shadow_tracer.ros.world.mesh_sources import MeshSources

BACKWARD_STAMPS = 1_000_000_000  # images this much older than the last one mean a restarted bag, not a late message

_MESH_KINDS = {"mesh": Mesh, "mesh_markers": MarkerArray, "mesh_marker": Marker, "mesh_cloud": PointCloud2}
_NO_GRID_MAP = (
    "grid_map_msgs cannot be imported here: it is not heard, and sun_map is not published; install "
    "ros-jazzy-grid-map-msgs and source the installation"
)


class Inputs:
    """The subscriptions, and what can be said about what they brought.

    Args:
        node: the node.
        guarded: wraps a callback so that it never raises.
        settings: called for the settings of the moment.
        work: does what there is to do now: in the callback that brought it, as another turn of the executor takes time.
        restarted: called with a sentence when the images start again at an earlier time.

    Attributes:
        depth: meter of depth images, good or not.
        losses: gaps in their numbers.
        depth_refused, pose_refused: images and poses that cannot be used.
        depth_format: encoding and size of the last good image.
        depth_bytes: bytes of its pixels.
        absent: what cannot be subscribed to, because there is no such type here.
        camera_frame: its frame, "" before there is one.
        last_stamp: its stamp [ns], 0 before there is one.
    """

    def __init__(
        self, node: Node, guarded: Callable[[Callable[..., None]], Callable[..., None]],
        settings: Callable[[], Settings], work: Callable[[], None], restarted: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.queue = FrameQueue()
        self.meshes = MeshSources(settings().max_triangles, settings().grid_map_layer)
        self.lighting = Lighting()
        self.depth = RateMeter()
        self.losses = LossMeter()
        self.depth_refused = Complaint()
        self.pose_refused = Complaint()
        self.depth_format = "-"
        self.depth_bytes = 0
        self.camera_frame = ""
        self.subscriptions: dict[str, FollowingSubscription] = {}
        self.absent: dict[str, AbsentSubscription] = {}
        self._node = node
        self._guarded = guarded
        self._settings = settings
        self._work = work
        self._restarted = restarted
        self.last_stamp = 0
        self._next_match = 0
        self._transport = ""
        self.meshes.layouts.check()

    def connect(self, frames: Frames, queries: Queries) -> None:
        """Where camera poses and queries go."""
        self._frames = frames
        self._queries = queries

    def subscribe(self) -> None:
        """Begin to listen."""
        # Of what is there at the same time, the executor takes first what was subscribed to first: a mesh that was sent
        # before an image is to count for it.
        for name, kind in _MESH_KINDS.items():
            profile = qos.newest_reliable() if name == "mesh" else qos.burst()
            self._add(name, kind, name, partial(self._on_mesh, name), profile, durability=True)
        self._subscribe_grid_map()
        self._subscribe_depth(self._settings().depth_image_transport)
        read = self._reader(CameraInfo, self.depth_refused, "camera_info", self._on_info)
        follow = {"reliability": True, "durability": True}
        self._add("info", CameraInfo, "depth/camera_info", read, qos.newest_reliable(), **follow)
        read = self._reader(PoseStamped, self.pose_refused, "camera_pose", self._on_camera_pose)
        self._add("pose", PoseStamped, "camera_pose", read, qos.history_of_sensor())
        read = self._reader(PointCloud2, self._queries.refused, "query", self._on_query)
        self._add("query", PointCloud2, "query", read, qos.burst())
        self.configure(self._settings())

    def unsubscribe(self) -> None:
        """Listen to nothing any more."""
        for name in list(self.subscriptions):
            self.subscriptions.pop(name).close()
        self.absent.clear()

    def configure(self, settings: Settings) -> None:
        """Follow new settings: order of processing, and which lights there are."""
        self.queue.every = settings.process == "every"
        now, now_ns = time.monotonic(), self._node.get_clock().now().nanoseconds
        self.meshes.choose_layer(settings.grid_map_layer, now, now_ns)
        if not self.subscriptions:
            return
        if settings.depth_image_transport != self._transport:
            self.subscriptions.pop("depth").close()
            self._subscribe_depth(settings.depth_image_transport)
        profile = qos.every_reliable() if self.queue.every else qos.newest_reliable()
        for name in ("mesh", "depth", "info"):
            self.subscriptions[name].ask(profile.depth)
        movable = {f"light {light.name}": light.name for light in settings.lights if light.type != "sun"}
        for key in [key for key in self.subscriptions if key.startswith("light ") and key not in movable]:
            self.subscriptions.pop(key).close()
        for key, name in movable.items():
            if key not in self.subscriptions:
                topic = f"lights/{name}/pose"
                read = self._reader(PoseStamped, self.pose_refused, topic, partial(self._on_light_pose, name))
                self._add(key, PoseStamped, f"~/{topic}", read, qos.newest_of_pose())

    def match(self) -> None:
        """Look after the publishers of one subscription, another one each time."""
        found: list[FollowingSubscription | AbsentSubscription]
        found = [*self.subscriptions.values(), *self.absent.values()]
        if found:
            self._next_match = (self._next_match + 1) % len(found)
            found[self._next_match].match()

    def mismatch(self, *names: str) -> str:
        """Why a publisher of one of these inputs cannot be heard; "" if all can."""
        both = self.subscriptions | self.absent
        found = (both[name].mismatch for name in names if name in both)
        return next(filter(None, found), "")

    def topic(self, name: str) -> str:
        """Resolved topic of an input; its name while the node does not listen."""
        both = self.subscriptions | self.absent
        return both[name].topic if name in both else name

    def restart(self, now_ns: int) -> None:
        """Time has jumped: nothing that waits is of the present."""
        self.last_stamp = 0
        self.queue.clear()
        self._queries.clear()
        self.meshes.store.restart_age(now_ns)

    def _add(self, name: str, kind: Any, topic: str, callback: Callable[..., None], profile: Any, **how: bool) -> None:
        self.subscriptions[name] = FollowingSubscription(
            self._node, kind, topic, self._guarded(callback), profile, **how
        )

    def _subscribe_grid_map(self) -> None:
        kind = grid_map_type()
        if kind is None:
            self.absent["grid_map"] = AbsentSubscription(self._node, "grid_map", _NO_GRID_MAP)
            return
        callback, follow = partial(self._on_mesh, "grid_map"), {"reliability": True, "durability": True}
        self._add("grid_map", kind, "grid_map", callback, qos.newest_reliable(), **follow)

    def _subscribe_depth(self, transport: str) -> None:
        self._transport = transport
        self.losses = LossMeter()
        topic, kind = "depth/image_rect", Image
        if transport != "raw":
            topic, kind = self._sibling(topic, transport), CompressedImage
        self._add("depth", kind, topic, partial(self._read_depth, kind), qos.newest_reliable(), reliability=True)

    def _sibling(self, topic: str, transport: str) -> str:
        """Where image_transport publishes an image packed: beside its topic after remapping, if it is not remapped
        itself."""
        sibling = f"{topic}/{transport}"
        resolve = self._node.resolve_topic_name
        remapped = resolve(sibling) != resolve(sibling, only_expand=True)
        return str(resolve(sibling) if remapped else f"{resolve(topic)}/{transport}")

    # Everything arrives as bytes: rclpy drops what it cannot read without a word, here it is counted and explained.

    @staticmethod
    def _reader(kind: Any, refused: Complaint, what: str, callback: Callable[[Any], None]) -> Callable[[bytes], None]:
        def read(data: bytes) -> None:
            try:
                message = deserialize_message(data, kind)
            except Exception as error:  # RMWError, UnicodeDecodeError, and what other middleware may raise
                text = f"{what}: these {len(data)} bytes are no {kind.__name__}: {error}"
                refused.add(text, time.monotonic())
                return
            callback(message)

        return read

    def _read_depth(self, kind: Any, data: bytes, info: dict[str, Any]) -> None:
        number = info.get("publication_sequence_number") or 0
        alone = self.subscriptions["depth"].publisher_count == 1
        self.losses.note(number, time.monotonic(), alone)
        start = time.perf_counter()
        self._reader(kind, self.depth_refused, "image", partial(self._on_depth, start=start))(data)

    def _on_depth(self, msg: Image | CompressedImage, start: float) -> None:
        now, stamp = time.monotonic(), stamp_ns(msg.header.stamp)
        self.depth.tick(now)
        try:
            image, depth = _unpacked(msg, self._settings())
        except MessageError as error:
            self.depth_refused.add(str(error), now)
            return
        if stamp < self.last_stamp - BACKWARD_STAMPS:
            self._restarted(f"depth images start again {(self.last_stamp - stamp) * 1e-9:.1f} s earlier")
        self.last_stamp = stamp
        packed = "" if image is msg else f", {self._transport}"
        self.depth_format = f"{image.encoding} {image.width} x {image.height}{packed}"
        self.depth_bytes = len(msg.data)
        self.camera_frame = self._settings().camera_frame or msg.header.frame_id
        # Frames that wait in line were taken before the meshes that come meanwhile.
        parts = self.meshes.store.snapshot() if self.queue.every else None
        decoding, topic = (time.perf_counter() - start) * 1e3, self.topic("depth")
        self.queue.put(WaitingFrame(image, depth, stamp, now, decoding, parts, topic))
        self._work()

    def _on_info(self, msg: CameraInfo) -> None:
        self.queue.put_info(msg)
        self._wake()

    def _on_mesh(self, topic: str, data: Any) -> None:
        self.meshes.receive(topic, data, time.monotonic(), self._node.get_clock().now().nanoseconds)

    def _on_camera_pose(self, msg: PoseStamped) -> None:
        try:
            stamp, pose = camera_pose(msg, self._settings().fixed_frame)
        except MessageError as error:
            self.pose_refused.add(f"camera_pose: {error}", time.monotonic())
            return
        self._frames.camera_poses.add(stamp, pose)
        self._wake()

    def _on_light_pose(self, name: str, msg: PoseStamped) -> None:
        try:
            pose = pose_matrix(msg.pose, "pose")
        except MessageError as error:
            self.pose_refused.add(f"lights/{name}/pose: {error}", time.monotonic())
            return
        self.lighting.move(name, LightPose(msg.header.frame_id, pose))

    def _on_query(self, msg: PointCloud2) -> None:
        self._queries.put(msg, self._settings().max_rays, time.monotonic())
        self._work()

    def _wake(self) -> None:
        if len(self.queue) or len(self._queries):
            self._work()


def _unpacked(msg: Image | CompressedImage, settings: Settings) -> tuple[Image, Any]:
    """The image with its header, without pixels where it came packed; and its depth. Raises MessageError."""
    if isinstance(msg, Image):
        return msg, decode_depth(msg, settings.depth_unit)
    depth = in_unit(compressed_depth.decode(msg.format, msg.data, settings.max_rays), settings.depth_unit)
    encoding = msg.format.partition(";")[0].strip()
    return Image(header=msg.header, height=depth.shape[0], width=depth.shape[1], encoding=encoding), depth
