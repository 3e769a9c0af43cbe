# SPDX-License-Identifier: Apache-2.0
"""A recorded bag as the node's inputs: which message is which, and what is read before the first frame is answered.

Topics are known by the short names of :data:`INPUTS`; those of lights are ``light <name>``.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from heapq import merge
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from shadow_tracer.apps.bag.files import ZSTD, BagError, BagFiles
from shadow_tracer.apps.bag.heads import HEADER, Heads, HeadsError, has_header
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.types import USUAL, Convert, Types, usual_name
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.compressed_depth import decode as decode_compressed
from shadow_tracer.ros.wire.grid_map import GRID_MAP
from shadow_tracer.ros.wire.messages import MessageError, camera_pose, image_layout, stamp_ns
from shadow_tracer.ros.world.frames import PoseBuffer
from shadow_tracer.ros.world.transform_tree import TransformTree

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
POSE = "geometry_msgs/msg/PoseStamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
INPUTS = {
    "depth": ("depth/image_rect", IMAGE),
    "info": ("depth/camera_info", "sensor_msgs/msg/CameraInfo"),
    "pose": ("camera_pose", POSE),
    "mesh": ("mesh", "shape_msgs/msg/Mesh"),
    "mesh_markers": ("mesh_markers", "visualization_msgs/msg/MarkerArray"),
    "mesh_marker": ("mesh_marker", "visualization_msgs/msg/Marker"),
    "mesh_cloud": ("mesh_cloud", CLOUD),
    "grid_map": ("grid_map", GRID_MAP),
    "query": ("query", CLOUD),
    "tf": ("/tf", TF),
    "tf_static": ("/tf_static", TF),
}
MESHES = ("mesh", "mesh_markers", "mesh_marker", "mesh_cloud", "grid_map")
_ONCE = ("tf", "pose")  # what is not read again when a bag is played
_SIBLING = "compressedDepth"  # what image_transport adds to the name of a topic


@dataclass(frozen=True)
class Message:
    """One message of the bag.

    Attributes:
        name: short name of its input, "" if it is none.
        topic: full name.
        time: log time [ns].
        kind: its type, by its name in ROS 2.
        raw: the bytes as they were recorded.
        convert: what makes them those of :attr:`kind` in ROS 2.
        connection: the topic as rosbags knows it.
        unread: how many of its bytes were left out, at its end.
    """

    name: str
    topic: str
    time: int
    kind: str
    raw: bytes
    convert: Convert
    connection: Any
    unread: int = 0

    @property
    def size(self) -> int:
        """How many bytes were recorded."""
        return len(self.raw) + self.unread

    @property
    def data(self) -> bytes:
        """Its bytes in plain CDR. Raises MessageError."""
        return self.convert(self.raw)


class Recording:
    """A bag that is open for reading. Use as a context manager.

    Args:
        path: a file, or the folder of a bag; of ROS 2 or ROS 1.
        names: how topics are called.
        lights: names of lights whose poses may be in it.
        max_pixels: a larger compressed depth image is refused before memory is taken for it.

    Attributes:
        warnings: what is missing of the recording, a sentence each.
        notes: what was chosen that was not asked for, a sentence each.

    Raises:
        BagError: it cannot be opened, has no depth images or camera_info, or a topic has another type.
        OSError: a file cannot be read, or there is no room to unpack it.
    """

    def __init__(self, path: Path, names: Names, lights: Iterable[str], max_pixels: int) -> None:
        self.path = path
        self._max_pixels = max_pixels
        self._names = names
        inputs = INPUTS | {f"light {name}": (f"~/lights/{name}/pose", POSE) for name in lights}
        self._wanted = {names.topic(topic): (name, kind) for name, (topic, kind) in inputs.items()}
        if len(self._wanted) < len(inputs):
            raise BagError("--remap: two inputs have got the same topic")
        self.notes: list[str] = []
        self._readers: list[AnyReader] = []
        self._types: dict[int, Types] = {}
        self._stack = ExitStack()
        try:
            self._files = BagFiles(path)
            self._stack.callback(self._files.close)
            self.warnings = self._files.warnings
            for file in self._files.paths:
                self._open(file)
            self._choose_depth()
            self._check()
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def connections(self) -> list[Any]:
        """Topics of the bag with their types; one that is in several files stands here several times."""
        return [connection for reader in self._readers for connection in reader.connections]

    def count(self, *names: str) -> int:
        """Messages of these inputs."""
        return sum(connection.msgcount for connection in self.connections if self._name(connection) in names)

    def messages(
        self, names: Iterable[str] | None, start: int | None = None, stop: int | None = None
    ) -> Iterator[Message]:
        """Messages of these inputs in the order of the log; None: of all topics. Only those at or after ``start`` and
        before ``stop`` [ns], None being no limit. Raises BagError."""
        wanted = None if names is None else set(names)
        chosen = []
        for number, reader in enumerate(self._readers):
            connections = [c for c in reader.connections if wanted is None or self._name(c) in wanted]
            if connections:  # for none rosbags would give all
                chosen.append(self._messages_of(number, connections, start, stop))
        return merge(*chosen, key=lambda message: message.time)

    def heads(self, names: Iterable[str], headers: Collection[str]) -> Iterator[Message]:
        """As :meth:`messages`; of those of the inputs ``headers`` no more than their header where a file's index allows
        it. All but transforms and poses is read again when the bag is played, which checks what is not checked here.

        Raises:
            BagError: as :meth:`messages`.
            HeadsError: an index says what is not so; :meth:`messages` does without it.
        """
        wanted, chosen = set(names), []
        for number, reader in enumerate(self._readers):
            connections = [c for c in reader.connections if self._name(c) in wanted]
            if connections:
                if self._files.paths[number].suffix == ".mcap":
                    chosen.append(self._heads_of(number, connections, headers))
                else:
                    chosen.append(self._messages_of(number, connections, None, None))
        return merge(*chosen, key=lambda message: message.time)

    def decode(self, message: Message) -> Any:
        """The message as an object; a compressed depth image as the image it holds.

        Raises:
            MessageError: its bytes are not one.
        """
        data = message.data
        try:
            content: Any = USUAL.deserialize_cdr(data, message.kind)
        except Exception as error:  # bytes can be wrong in any way
            raise MessageError(f"message: not a {message.kind}: {error}") from error
        return _unpacked(content, self._max_pixels) if message.kind == COMPRESSED else content

    def copier(self, message: Message) -> tuple[bytes, Any]:
        """Bytes of any message for a new bag of ROS 2, and the types that define it. Raises MessageError."""
        convert, types = self._types[id(message.connection.owner)].copier(message.connection.msgtype)
        return convert(message.raw), types

    def _open(self, file: Path) -> None:
        try:
            reader = AnyReader([file], default_typestore=USUAL)
            self._stack.enter_context(reader)
        except Exception as error:  # of the library, which trusts what it reads
            raise BagError(f"{self.path}: the bag cannot be read: {type(error).__name__} {error}") from error
        self._readers.append(reader)
        types = Types(reader.typestore, reader.is2)
        for connection in reader.connections:
            self._types[id(connection.owner)] = types

    def _messages_of(
        self, number: int, connections: list[Any], start: int | None, stop: int | None
    ) -> Iterator[Message]:
        known = {connection.id: self._described(connection) for connection in connections}
        try:
            for connection, time, data in self._readers[number].messages(connections, start, stop):
                name, topic, kind, convert = known[connection.id]
                yield Message(name, topic, time, kind, data, convert, connection)
        except Exception as error:  # of the library, which trusts what it reads
            if "not in timestamp order" in str(error):  # written without chunks, by several threads
                files = [path for path in self._files.paths if path.is_relative_to(self.path)]
                file = files[number] if len(files) == len(self._readers) else self.path  # others were unpacked
                cure = f"mcap sort {shlex.quote(str(file))} -o sorted.mcap"
                raise BagError(f"{file}: an mcap file without index that is not sorted; try: {cure}") from error
            raise BagError(f"{self.path}: the bag is damaged: {type(error).__name__} {error}") from error

    def _heads_of(self, number: int, connections: list[Any], headers: Collection[str]) -> Iterator[Message]:
        try:
            heads = Heads(self._files.paths[number])
        except HeadsError:
            yield from self._messages_of(number, connections, None, None)
            return
        known = {connection.topic: (*self._described(connection), connection) for connection in connections}
        short = {c.topic for c in connections if self._name(c) in headers and self._is_plain(c)}
        again = {c.topic for c in connections if self._name(c) not in _ONCE}
        with heads:
            for head in heads.read({topic: HEADER if topic in short else None for topic in known}, again):
                name, topic, kind, convert, connection = known[head.topic]
                raw = head.data
                if raw[:4] == ZSTD or not has_header(name, raw):
                    raw = head.rest()
                yield Message(name, topic, head.time, kind, raw, convert, connection, head.size - len(raw))

    def _described(self, connection: Any) -> tuple[str, str, str, Convert]:
        """Name of its input, full topic, type, and what makes bytes those of this type."""
        types, kind = self._types[id(connection.owner)], connection.msgtype
        convert = types.converter(kind) or types.copier(kind)[0]
        return self._name(connection), _full(connection), usual_name(kind), convert

    def _is_plain(self, connection: Any) -> bool:
        return self._types[id(connection.owner)].is_plain(connection.msgtype)

    def _name(self, connection: Any) -> str:
        return self._wanted.get(_full(connection), ("", ""))[0]

    def _topic(self, name: str) -> str:
        return next(topic for topic, (other, _) in self._wanted.items() if other == name)

    def _choose_depth(self) -> None:
        """Where the depth image is there only compressed, take that."""
        topic = self._topic("depth")
        kinds = {_full(c): c.msgtype for c in self.connections if c.msgcount}
        if topic not in kinds and kinds.get(f"{topic}/{_SIBLING}") == COMPRESSED:
            self.notes.append(f"note: {topic} is not in the bag; {topic}/{_SIBLING} is used")
            del self._wanted[topic]
            topic = f"{topic}/{_SIBLING}"
        self._wanted[topic] = ("depth", COMPRESSED if kinds.get(topic) == COMPRESSED else IMAGE)

    def _check(self) -> None:
        for connection in self.connections:
            name, kind = self._wanted.get(_full(connection), ("", ""))
            if name and usual_name(connection.msgtype) != kind:
                raise BagError(f"{connection.topic}: expected {kind}, the bag has {connection.msgtype}")
            if name and self._types[id(connection.owner)].converter(connection.msgtype) is None:
                converted = self.path.with_name(f"{self.path.stem}_jazzy")
                raise BagError(
                    f"{connection.topic}: {kind} is defined differently in this bag than in ROS 2 Jazzy; convert it "
                    f"with: rosbags-convert --src {shlex.quote(str(self.path))} --dst {shlex.quote(str(converted))} "
                    "--dst-typestore ros2_jazzy"
                )
        for name in ("depth", "info"):
            if not self.count(name):
                raise BagError(self._absent(name))

    def _absent(self, name: str) -> str:
        plain, kind = self._names.before(INPUTS[name][0]), INPUTS[name][1]
        there = {_full(c) for c in self.connections if c.msgtype == kind and c.msgcount}
        if name == "depth":
            ending = f"/{_SIBLING}"
            compressed = {_full(c) for c in self.connections if c.msgtype == COMPRESSED and c.msgcount}
            there |= {topic.removesuffix(ending) for topic in compressed if topic.endswith(ending)}
        hint = f"use --remap {plain}:=... with one of {', '.join(sorted(there))}" if there else "it has no such topic"
        return "; ".join((f"{self.path}: no {kind} on {self._topic(name)}", hint, *self.warnings))


def _full(connection: Any) -> str:
    """Full name of a topic; ROS 1 may have recorded it without the slash before it."""
    return f"/{connection.topic.lstrip('/')}"


def _unpacked(message: Any, max_pixels: int) -> Any:
    """The sensor_msgs/Image of a compressed depth image. Raises MessageError."""
    depth = decode_compressed(message.format, message.data, max_pixels)
    encoding = "16UC1" if depth.dtype == np.uint16 else "32FC1"
    data = depth.reshape(-1).view(np.uint8)
    return USUAL.types[IMAGE](header=message.header, data=data, **image_layout(depth, encoding))


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


BACKGROUND = ("tf", "tf_static", "pose", "info")


class BackgroundReader:
    """Takes the messages of :data:`BACKGROUND` in the order of the log; of two with one stamp the last counts.

    Attributes:
        found: what they say, whole after :meth:`finish`.
    """

    def __init__(self, settings: Settings) -> None:
        self.found = Background()
        self._fixed_frame = settings.fixed_frame
        self._static: dict[str, Any] = {}

    def take(self, name: str, content: Any) -> None:
        """Take a message of an input. Raises MessageError."""
        found = self.found
        if name == "info":
            found.first_info = content if found.first_info is None else found.first_info
            found.infos[stamp_ns(content.header.stamp)] = content
        elif name == "pose":
            found.poses.add(*camera_pose(content, self._fixed_frame))
        elif name == "tf":
            add_transforms(found, content, False)
        else:
            for transform in content.transforms:
                self._static.setdefault(transform.child_frame_id, transform)

    def finish(self) -> Background:
        """All of it, when the last message is taken."""
        for transform in self._static.values():
            with suppress(MessageError):  # counted when the log comes to it
                _add(self.found.tree, transform, True)
        return self.found


def read_background(recording: Recording, settings: Settings) -> Background:
    """Read transforms, poses of the camera and camera_info."""
    reader = BackgroundReader(settings)
    for message in recording.messages(BACKGROUND):
        try:
            reader.take(message.name, recording.decode(message))
        except MessageError as error:
            reader.found.refuse(message.name, error)
    return reader.finish()


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
