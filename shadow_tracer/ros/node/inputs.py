# SPDX-License-Identifier: Apache-2.0
"""What the node subscribes to. Callbacks check and store; the work is done in one step afterwards."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker, MarkerArray

from shadow_tracer.ros.diagnostics import Complaint
from shadow_tracer.ros.node import qos
from shadow_tracer.ros.node.camera_input import CameraInput, reader
from shadow_tracer.ros.node.queries import Queries
from shadow_tracer.ros.node.subscriptions import AbsentSubscription, FollowingSubscription
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.layouts import grid_map_type
from shadow_tracer.ros.wire.messages import MessageError, pose_matrix
from shadow_tracer.ros.world.frames import Frames, PoseBuffer
from shadow_tracer.ros.world.lighting import Lighting, LightPose
from shadow_tracer.ros.world.mesh_sources import MeshSources

_ALIVE = 3.0  # a camera that has sent nothing for so many seconds does not count
_EACH_TURN = 12  # so many publishers more, and one more is looked after each time

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
        cameras: what comes of each camera, by name; "" is the name of a single one that has none.
        pose_refused: poses, of cameras and lights, that cannot be used.
        absent: what cannot be subscribed to, because there is no such type here.
        last_stamp: stamp of the last image of any camera [ns], 0 before there is one.
    """

    def __init__(
        self, node: Node, guarded: Callable[[Callable[..., None]], Callable[..., None]],
        settings: Callable[[], Settings], work: Callable[[], None], restarted: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.node = node
        self.settings = settings
        self.meshes = MeshSources(settings().max_triangles, settings().grid_map_layer)
        self.lighting = Lighting()
        self.pose_refused = Complaint()
        self.subscriptions: dict[str, FollowingSubscription] = {}
        self.absent: dict[str, AbsentSubscription] = {}
        self.last_stamp = 0
        self.cameras = {name: CameraInput(name, self) for name in settings().camera_names}
        self._guarded = guarded
        self._work = work
        self._restarted = restarted
        self._jumps: dict[str, float] = {}
        self._next_match = 0
        self.meshes.layouts.check()

    def connect(self, frames: Frames, queries: Queries) -> None:
        """Where camera poses and queries go."""
        self.frames = frames
        self._queries = queries
        frames.poses_of.update({name: PoseBuffer() for name in self.cameras})

    @property
    def camera_frame(self) -> str:
        """Optical frame of the depth images, "" before there is one; of several cameras none is more than others."""
        return next(iter(self.cameras.values())).frame if len(self.cameras) == 1 else ""

    @property
    def waiting(self) -> int:
        """Images that wait, of all cameras."""
        return sum(len(camera.queue) for camera in self.cameras.values())

    def subscribe(self) -> None:
        """Begin to listen."""
        # Of what is there at the same time, the executor takes first what was subscribed to first: a mesh that was sent
        # before an image is to count for it.
        for name, kind in _MESH_KINDS.items():
            profile = qos.newest_reliable() if name == "mesh" else qos.burst()
            self.add(name, kind, name, partial(self._on_mesh, name), profile, durability=True)
        self._subscribe_grid_map()
        for camera in self.cameras.values():
            camera.subscribe()
        read = reader(PointCloud2, self._queries.refused, "query", self._on_query)
        self.add("query", PointCloud2, "query", read, qos.burst())
        self.configure(self.settings())

    def unsubscribe(self) -> None:
        """Listen to nothing any more."""
        for name in list(self.subscriptions):
            self.subscriptions.pop(name).close()
        self.absent.clear()

    def configure(self, settings: Settings) -> None:
        """Follow new settings: order of processing, and which lights there are."""
        now, now_ns = time.monotonic(), self.node.get_clock().now().nanoseconds
        self.meshes.choose_layer(settings.grid_map_layer, now, now_ns)
        for camera in self.cameras.values():
            camera.configure(settings.of(camera.name))
        if not self.subscriptions:
            return
        profile = qos.every_reliable() if settings.process == "every" else qos.newest_reliable()
        self.subscriptions["mesh"].ask(profile.depth)
        movable = {f"light {light.name}": light.name for light in settings.lights if light.type != "sun"}
        for key in [key for key in self.subscriptions if key.startswith("light ") and key not in movable]:
            self.subscriptions.pop(key).close()
        for key, name in movable.items():
            if key not in self.subscriptions:
                topic = f"lights/{name}/pose"
                read = reader(PoseStamped, self.pose_refused, topic, partial(self._on_light_pose, name))
                self.add(key, PoseStamped, f"~/{topic}", read, qos.newest_of_pose())

    def match(self) -> None:
        """Look after the publishers of one subscription, or a few of many, others each time."""
        found: list[FollowingSubscription | AbsentSubscription]
        found = [*self.subscriptions.values(), *self.absent.values()]
        for _ in range(min(len(found), 1 + len(found) // _EACH_TURN)):
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
        for camera in self.cameras.values():
            camera.restart()
        self._jumps.clear()
        self._queries.clear()
        self.meshes.store.restart_age(now_ns)

    def add(self, name: str, kind: Any, topic: str, callback: Callable[..., None], profile: Any, **how: bool) -> None:
        """Subscribe; ``how`` as for :class:`FollowingSubscription`."""
        self.subscriptions[name] = FollowingSubscription(
            self.node, kind, topic, self._guarded(callback), profile, **how
        )

    def _subscribe_grid_map(self) -> None:
        kind = grid_map_type()
        if kind is None:
            self.absent["grid_map"] = AbsentSubscription(self.node, "grid_map", _NO_GRID_MAP)
            return
        callback, follow = partial(self._on_mesh, "grid_map"), {"reliability": True, "durability": True}
        self.add("grid_map", kind, "grid_map", callback, qos.newest_reliable(), **follow)

    def note_image(self, camera: CameraInput) -> None:
        """A good image of a camera waits."""
        self.last_stamp = camera.last_stamp
        self.frames.note_camera(camera.name, camera.frame)
        self._work()

    def note_jump(self, camera: CameraInput, why: str) -> None:
        """The images of a camera start again at an earlier time: nothing that waits of it is of the present. If all
        cameras that send anything have done so, that is a recording that begins again, and nothing else is either."""
        now = time.monotonic()
        self._jumps[camera.name] = now
        self._jumps = {name: then for name, then in self._jumps.items() if now - then < _ALIVE}
        if all(name in self._jumps or each.depth.age(now) > _ALIVE for name, each in self.cameras.items()):
            self._restarted(why)
            return
        camera.restart()
        self.frames.poses_of[camera.name].clear()
        self.node.get_logger().info(f"camera {camera.name}: {why}: what waited of it, and its poses, are cleared")

    def keep_newest(self) -> None:
        """Drop all images but the last of each camera; with ``process: every`` none."""
        for camera in self.cameras.values():
            camera.queue.keep_newest()

    def wake(self) -> None:
        """Something has come that images or queries may wait for."""
        if self.waiting or len(self._queries):
            self._work()

    def _on_mesh(self, topic: str, data: Any) -> None:
        self.meshes.receive(topic, data, time.monotonic(), self.node.get_clock().now().nanoseconds)

    def _on_light_pose(self, name: str, msg: PoseStamped) -> None:
        try:
            pose = pose_matrix(msg.pose, "pose")
        except MessageError as error:
            self.pose_refused.add(f"lights/{name}/pose: {error}", time.monotonic())
            return
        self.lighting.move(name, LightPose(msg.header.frame_id, pose))

    def _on_query(self, msg: PointCloud2) -> None:
        self._queries.put(msg, self.settings().max_rays, time.monotonic())
        self._work()
