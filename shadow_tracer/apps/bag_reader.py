# SPDX-License-Identifier: Apache-2.0
"""A recorded bag as the node's inputs: which message is which, and what is read before the first frame is answered.

Topics are known by the short names of :data:`INPUTS`; those of lights are ``light <name>``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from shadow_tracer.apps.bag_names import Names
from shadow_tracer.ros.frames import PoseBuffer
from shadow_tracer.ros.messages import MessageError, camera_pose, stamp_ns
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.transform_tree import TransformTree

POSE = "geometry_msgs/msg/PoseStamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
INPUTS = {
    "depth": ("depth/image_rect", "sensor_msgs/msg/Image"),
    "info": ("depth/camera_info", "sensor_msgs/msg/CameraInfo"),
    "pose": ("camera_pose", POSE),
    "mesh": ("mesh", "shape_msgs/msg/Mesh"),
    "mesh_markers": ("mesh_markers", "visualization_msgs/msg/MarkerArray"),
    "mesh_marker": ("mesh_marker", "visualization_msgs/msg/Marker"),
    "mesh_cloud": ("mesh_cloud", CLOUD),
    "query": ("query", CLOUD),
    "tf": ("/tf", TF),
    "tf_static": ("/tf_static", TF),
}
MESHES = ("mesh", "mesh_markers", "mesh_marker", "mesh_cloud")


class BagError(Exception):
    """The bag cannot be used, or not be written; the text says why and what helps."""


@dataclass(frozen=True)
class Message:
    """One message of the bag: short name of its input ("" if it is none), log time [ns], connection and bytes."""

    name: str
    time: int
    connection: Any
    data: bytes


class Recording:
    """A bag that is open for reading. Use as a context manager.

    Args:
        path: an mcap or sqlite3 file, or the folder of a bag.
        names: how topics are called.
        lights: names of lights whose poses may be in it.

    Raises:
        BagError: it cannot be opened, has no depth images or camera_info, or a topic has another type.
    """

    def __init__(self, path: Path, names: Names, lights: Iterable[str]) -> None:
        self.path = path
        inputs = INPUTS | {f"light {name}": (f"~/lights/{name}/pose", POSE) for name in lights}
        self._wanted = {names.topic(topic): (name, kind) for name, (topic, kind) in inputs.items()}
        if len(self._wanted) < len(inputs):
            raise BagError("--remap: two inputs have got the same topic")
        self._usual = get_typestore(Stores.ROS2_JAZZY)
        try:
            self._reader = AnyReader([path], default_typestore=self._usual)
            if not self._reader.is2:
                raise BagError(f"{path}: expected a bag of ROS 2; convert it with rosbags-convert")
            self._reader.open()
        except FileNotFoundError as error:
            raise BagError(f"{path}: expected an mcap or db3 file or the folder of a bag, found none") from error
        except BagError:
            raise
        except Exception as error:  # of the library, which trusts what it reads
            raise BagError(f"{path}: the bag cannot be read: {type(error).__name__} {error}") from error
        try:
            self._check()
        except BaseException:
            self._reader.close()
            raise

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.close()

    @property
    def typestore(self) -> Any:
        """The message types of the bag."""
        return self._reader.typestore

    @property
    def connections(self) -> list[Any]:
        """Topics of the bag with their types."""
        return self._reader.connections

    def count(self, *names: str) -> int:
        """Messages of these inputs."""
        return sum(connection.msgcount for connection in self._connections(names))

    def messages(self, names: Iterable[str] | None) -> Iterator[Message]:
        """Messages of these inputs in the order of the log; None: of all topics. Raises BagError."""
        chosen = self.connections if names is None else self._connections(names)
        if not chosen:
            return
        try:
            for connection, time, data in self._reader.messages(chosen):
                yield Message(self._name(connection), time, connection, data)
        except Exception as error:  # of the library, which trusts what it reads
            raise BagError(f"{self.path}: the bag is damaged: {type(error).__name__} {error}") from error

    def decode(self, message: Message) -> Any:
        """The message as an object. Raises MessageError where its bytes are not one."""
        try:
            return self._reader.deserialize(message.data, message.connection.msgtype)
        except Exception as error:  # bytes can be wrong in any way
            raise MessageError(f"message: not a {message.connection.msgtype}: {error}") from error

    def _name(self, connection: Any) -> str:
        return self._wanted.get(connection.topic, ("", ""))[0]

    def _connections(self, names: Iterable[str]) -> list[Any]:
        wanted = set(names)
        return [connection for connection in self.connections if self._name(connection) in wanted]

    def _defined_as_usual(self, kind: str) -> bool:
        try:
            return bool(self.typestore.hash_rihs01(kind) == self._usual.hash_rihs01(kind))
        except Exception:  # of the library: the definition uses what is not defined
            return False

    def _check(self) -> None:
        for connection in self.connections:
            name, kind = self._wanted.get(connection.topic, ("", ""))
            if name and connection.msgtype != kind:
                raise BagError(f"{connection.topic}: expected {kind}, the bag has {connection.msgtype}")
            if name and not self._defined_as_usual(kind):
                raise BagError(f"{connection.topic}: {kind} is defined differently in this bag than in ROS 2 Jazzy")
        topics = {name: topic for topic, (name, _) in self._wanted.items()}
        for name in ("depth", "info"):
            if not self.count(name):
                plain, kind = INPUTS[name]
                there = sorted({c.topic for c in self.connections if c.msgtype == kind})
                hint = f"use --remap {plain}:=... with one of {', '.join(there)}" if there else "it has no such topic"
                raise BagError(f"{self.path}: no {kind} on {topics[name]}; {hint}")


@dataclass
class Background:
    """What holds for the whole bag and may stand in it behind the frame that needs it.

    Attributes:
        tree: all transforms, of static ones the first of each frame.
        poses: all poses of the camera.
        infos: camera_info by stamp.
        first_info: the first of them.
        refused: how many messages cannot be used, and why, by input.
    """

    tree: TransformTree = field(default_factory=TransformTree)
    poses: PoseBuffer = field(default_factory=lambda: PoseBuffer(capacity=2**62))
    infos: dict[int, Any] = field(default_factory=dict)
    first_info: Any = None
    refused: dict[str, list[str]] = field(default_factory=dict)

    def refuse(self, name: str, error: Exception) -> None:
        """Count what cannot be used."""
        self.refused.setdefault(name, []).append(str(error))


def read_background(recording: Recording, settings: Settings) -> Background:
    """Read transforms, poses of the camera and camera_info; of two with one stamp the last counts."""
    found = Background()
    static: dict[str, Any] = {}
    for message in recording.messages(("tf", "tf_static", "pose", "info")):
        try:
            content = recording.decode(message)
            if message.name == "info":
                found.first_info = content if found.first_info is None else found.first_info
                found.infos[stamp_ns(content.header.stamp)] = content
            elif message.name == "pose":
                found.poses.add(*camera_pose(content, settings.fixed_frame))
            elif message.name == "tf":
                add_transforms(found, content, False)
            else:
                for transform in content.transforms:
                    static.setdefault(transform.child_frame_id, transform)
        except MessageError as error:
            found.refuse(message.name, error)
    for transform in static.values():
        with suppress(MessageError):  # counted when the log comes to it
            _add(found.tree, transform, True)
    return found


def add_transforms(background: Background, message: Any, static: bool) -> None:
    """Add the transforms of a tf2_msgs/TFMessage; those that cannot be are counted."""
    for transform in message.transforms:
        try:
            _add(background.tree, transform, static)
        except MessageError as error:
            background.refuse("tf_static" if static else "tf", error)


def _add(tree: TransformTree, transform: Any, static: bool) -> None:
    t, q = transform.transform.translation, transform.transform.rotation
    child, parent = transform.child_frame_id, transform.header.frame_id
    tree.add(child, parent, stamp_ns(transform.header.stamp), (t.x, t.y, t.z), (q.x, q.y, q.z, q.w), static)
