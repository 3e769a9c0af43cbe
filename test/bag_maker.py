# SPDX-License-Identifier: Apache-2.0
"""Makes small bags with rosbags alone: depth images, camera_info, transforms, poses, meshes. Times in ns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from shadow_tracer.ros.wire.grid_map import DEFINITIONS, GRID_MAP, GRID_MAP_INFO

TYPES = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in DEFINITIONS.items():
    TYPES.register(get_types_from_msg(_text, _name))
STILL = (0.0, 0.0, 0.0, 1.0)


def make(kind: str, **fields: Any) -> Any:
    """A message of a type such as ``std_msgs/Header``."""
    return TYPES.types[kind.replace("/", "/msg/")](**fields)


def header(stamp: int, frame: str) -> Any:
    """A header."""
    time = make("builtin_interfaces/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return make("std_msgs/Header", stamp=time, frame_id=frame)


def image(depth: np.ndarray, stamp: int, frame: str = "camera") -> Any:
    """A depth image of float32 metres or uint16 millimetres."""
    return make(
        "sensor_msgs/Image",
        header=header(stamp, frame),
        height=depth.shape[0],
        width=depth.shape[1],
        encoding={"float32": "32FC1", "uint16": "16UC1"}[depth.dtype.name],
        is_bigendian=0,
        step=depth.shape[1] * depth.itemsize,
        data=np.ascontiguousarray(depth).reshape(-1).view(np.uint8),
    )


def info(width: int, height: int, stamp: int, focal: float, frame: str = "camera") -> Any:
    """The camera_info of an ideal camera."""
    cx, cy = (width - 1) / 2, (height - 1) / 2
    return make(
        "sensor_msgs/CameraInfo",
        header=header(stamp, frame),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([focal, 0, cx, 0, focal, cy, 0, 0, 1.0]),
        r=np.eye(3).reshape(-1),
        p=np.array([focal, 0, cx, 0, 0, focal, cy, 0, 0, 0, 1.0, 0]),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def pose(stamp: int, frame: str, position: Sequence[float], quaternion: Sequence[float] = STILL) -> Any:
    """A PoseStamped."""
    point = make("geometry_msgs/Point", **dict(zip("xyz", map(float, position), strict=True)))
    turn = make("geometry_msgs/Quaternion", **dict(zip("xyzw", map(float, quaternion), strict=True)))
    return make(
        "geometry_msgs/PoseStamped",
        header=header(stamp, frame),
        pose=make("geometry_msgs/Pose", position=point, orientation=turn),
    )


def transform(
    parent: str, child: str, stamp: int, position: Sequence[float], quaternion: Sequence[float] = STILL
) -> Any:
    """A TFMessage with one transform."""
    shift = make("geometry_msgs/Vector3", **dict(zip("xyz", map(float, position), strict=True)))
    turn = make("geometry_msgs/Quaternion", **dict(zip("xyzw", map(float, quaternion), strict=True)))
    stamped = make(
        "geometry_msgs/TransformStamped",
        header=header(stamp, parent),
        child_frame_id=child,
        transform=make("geometry_msgs/Transform", translation=shift, rotation=turn),
    )
    return make("tf2_msgs/TFMessage", transforms=[stamped])


def cloud(points: np.ndarray, stamp: int, frame: str, more: Sequence[str] = ()) -> Any:
    """A PointCloud2 of (N, 3) points, float32, and of as many ``more`` fields as the points have further columns."""
    names = ["x", "y", "z", *more]
    field = [make("sensor_msgs/PointField", name=n, offset=4 * i, datatype=7, count=1) for i, n in enumerate(names)]
    data = np.ascontiguousarray(points, np.float32).reshape(-1).view(np.uint8)
    return make(
        "sensor_msgs/PointCloud2",
        header=header(stamp, frame),
        height=1,
        width=len(points),
        fields=field,
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=data,
        is_dense=True,
    )


class BagMaker:
    """Messages in the order of the log, a millisecond each."""

    def __init__(self) -> None:
        self._log: list[tuple[str, str, int, bytes]] = []
        self.now = 10**12

    def add(self, topic: str, message: Any) -> None:
        """Append a message."""
        self.raw(topic, message.__msgtype__, bytes(TYPES.serialize_cdr(message, message.__msgtype__)))

    def raw(self, topic: str, kind: str, data: bytes) -> None:
        """Append any bytes as a message."""
        self.now += 1_000_000
        self._log.append((topic, kind, self.now, data))

    def write(
        self,
        path: Path,
        storage: StoragePlugin = StoragePlugin.MCAP,
        compression: CompressionMode | None = None,
        types: Any = TYPES,
        part: slice = slice(None),
    ) -> Path:
        """Write a bag into a new folder, of messages as ``types`` define them; returns it."""
        writer = Writer(path, version=9, storage_plugin=storage)
        if compression:
            writer.set_compression(compression, CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for topic, kind, time, data in self._log[part]:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=types)
                writer.write(connections[topic], time, data if types is TYPES else redefined(data, kind, types))
        return path

    def write_ros1(
        self, path: Path, types: Any = None, renamed: dict[str, str] | None = None, compression: str = "none"
    ) -> Path:
        """Write a bag of ROS 1, whose headers count; returns its file. ``renamed`` types are defined in ``types``."""
        types = types or ros1_types()
        writer = Writer1(path)
        if compression != "none":
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        with writer:
            connections: dict[str, Any] = {}
            for number, (topic, kind, time, data) in enumerate(self._log, 1):
                name = (renamed or {}).get(kind, kind)
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=types)
                writer.write(connections[topic], time, ros1_bytes(data, kind, number, types))
        return path


def ros1_types() -> Any:
    """The types of ROS 1 Noetic, with those of tf2 and of grid_map."""
    types = get_typestore(Stores.ROS1_NOETIC)
    for kind in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    header = "std_msgs/Header header\n"
    types.register(get_types_from_msg(header + DEFINITIONS[GRID_MAP_INFO], GRID_MAP_INFO))
    types.register(get_types_from_msg(DEFINITIONS[GRID_MAP].removeprefix(header), GRID_MAP))
    return types


def redefined(data: bytes, kind: str, types: Any) -> bytes:
    """Bytes of a message of Jazzy as other types of ROS 2 have them; what is no such message stays."""
    if kind not in TYPES.fielddefs:
        return data
    return bytes(types.serialize_cdr(older(TYPES.deserialize_cdr(data, kind), types), kind))


def ros1_bytes(data: bytes, kind: str, number: int, types: Any) -> bytes:
    """Bytes of a message of Jazzy as ROS 1 has them; a header at the start gets this number."""
    try:
        message = TYPES.deserialize_cdr(data, kind)
    except SerdeError:
        return data
    old = older(message, types)
    if kind == GRID_MAP:  # whose header is in its info
        old.info.header = older(message.header, types)
    raw = bytearray(types.serialize_ros1(old, kind))
    if TYPES.fielddefs[kind][1][0][0] == "header":
        raw[:4] = number.to_bytes(4, "little")
    return bytes(raw)


def older(message: Any, types: Any) -> Any:
    """The message of the same name in other types: without the fields that these lack, 0 in those they have beyond."""
    if isinstance(message, list):
        return [older(part, types) for part in message]
    kind = getattr(message, "__msgtype__", None)
    if kind is None:
        return message
    values = {}
    for name, _ in types.fielddefs[kind][1]:
        values[name] = older(getattr(message, name.lower() if len(name) == 1 else name, 0), types)
    return types.types[kind](**values)


def read(path: Path) -> dict[str, list[Any]]:
    """All messages of a bag by topic."""
    found: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


def pixels(message: Any) -> np.ndarray:
    """(H, W) or (H, W, 3) of a mono8, 16UC1 or rgb8 image."""
    kind, channels = {"mono8": (np.uint8, 1), "16UC1": (np.uint16, 1), "rgb8": (np.uint8, 3)}[message.encoding]
    shape = (message.height, message.width) + ((channels,) if channels > 1 else ())
    return message.data.view(kind).reshape(shape)
