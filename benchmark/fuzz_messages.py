# SPDX-License-Identifier: Apache-2.0
"""Messages that no honest publisher sends: random, mutated, cut, with impossible counts; and the good ones beside them.

A message is either any bytes, or an object with fields of any value that is serialised before it is thrown.
"""

from __future__ import annotations

import array
import random
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from compressed_images import compressed_msg
from geometry_msgs.msg import PoseStamped
from harness import image_msg, info_msg, plate, time_msg, wall
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image, PointCloud2, PointField

from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_marker, encode_markers
from shadow_tracer.scene.distortion import COUNTS as COUNTS_OF

COUNTS = (0, 1, 2, 3, 255, 2**16, 2**24, 2**28, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1)
NUMBERS = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 5e-324, 1e-300, 1.7e308, -1.7e308, 3.4e38, 1e9, -1.0)
TEXTS = (
    "",
    "map",
    "camera",
    "/",
    "a" * 3000,
    "\u00e9\u4e16",
    "x\ny",
    "16UC1",
    "32FC1",
    "mono16",
    "8UC1",
    "bgr8",
    "16uc1",
)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, 1e-45, 3e38, -1.0, 10100.0)
SMALL_WIDTH, SMALL_HEIGHT = 16, 12
SENDER = "camera"  # frame of everything that is good


def _stamp(number: int) -> int:
    """A stamp [ns] that no good frame has."""
    return 10**12 + number * 10**6 + 500_000


@dataclass
class Message:
    """One message for an input.

    Attributes:
        payload: bytes, or a message object.
        bad: it must be refused; otherwise it may be good by chance.
    """

    payload: Any
    bad: bool = False


@dataclass
class Input:
    """An input of the node.

    Attributes:
        name: what the table calls it.
        topic: before remapping.
        good: messages that bring the good state back, given a stamp [ns].
        make: a message to try, given the random numbers and the number of the message.
        with_image: a depth image of the same stamp follows each message, and a refusal shows when that is traced.
        with_frame: good messages go along with every good frame.
        parameters: what the node needs for this input to count.
        codec: good frames are packed so.
    """

    name: str
    topic: str
    good: Callable[[int], Sequence[Any]]
    make: Callable[[random.Random, int], Message]
    with_image: bool = False
    with_frame: bool = False
    parameters: dict[str, Any] = field(default_factory=dict)
    codec: str = ""


def any_bytes(rng: random.Random, most: int = 400) -> bytes:
    """Random bytes, half of them behind a plausible encapsulation."""
    data = rng.randbytes(rng.randrange(most))
    return (
        rng.choice((b"\x00\x01\x00\x00", b"\x00\x00\x00\x00", b"\x00\x07\x00\x00")) + data
        if rng.random() < 0.5
        else data
    )


def mutated(rng: random.Random, data: bytes, head: int = 200) -> bytes:
    """One to three changes: bits, counts, numbers, endian, cut, grown. Mostly within the first ``head`` bytes."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        if len(changed) < 8:
            break
        place = rng.randrange(len(changed) if rng.random() < 0.3 else min(head, len(changed)))
        aligned = 4 + (place - 4) // 4 * 4 if place >= 4 else 4
        what = rng.randrange(8)
        order = "<" if changed[1] & 1 else ">"
        if what <= 1:
            changed[place] ^= 1 << rng.randrange(8)
        elif what <= 3 and aligned + 4 <= len(changed):
            struct.pack_into(order + "I", changed, aligned, rng.choice(COUNTS))
        elif what == 4 and aligned + 8 <= len(changed):
            struct.pack_into(order + "d", changed, aligned, rng.choice(NUMBERS))
        elif what == 5:
            changed[1] ^= 1
        elif what == 6:
            del changed[rng.randrange(len(changed)) :]
        else:
            changed[place:place] = rng.randbytes(rng.randrange(1, 9))
    return bytes(changed)


def _mangled(rng: random.Random, number: int, message: Any) -> Message:
    """The bytes of a good message, cut (at another byte each time) or mutated."""
    data = bytes(serialize_message(message))
    if number % 2:
        return Message(data[: number // 20 % min(len(data), 600)], True)
    return Message(mutated(rng, data, 120))


def _bytes_of(value: bytes) -> array.array[int]:
    return array.array("B", value)


def _header(rng: random.Random, message: Any) -> None:
    stamp = message.header.stamp
    if rng.random() < 0.5:
        stamp.sec = rng.choice((0, -1, -(2**31), 2**31 - 1, rng.randrange(2**31)))
        stamp.nanosec = rng.choice((0, 999_999_999, 10**9, 2**32 - 1))
    else:
        message.header.frame_id = rng.choice(TEXTS)


# Depth images


def _depth_good(stamp: int) -> Sequence[Any]:
    return (image_msg(wall(), stamp, SENDER),)


def _depth_make(rng: random.Random, number: int) -> Message:
    depth = np.full((SMALL_HEIGHT, SMALL_WIDTH), 2.0, np.float32)
    if rng.random() < 0.5:
        depth = (depth * 1000).astype(np.uint16)
    image = image_msg(depth, _stamp(number), SENDER)
    size = depth.itemsize
    kind = number % 10
    if kind < 2:
        return _mangled(rng, number, image)
    if kind == 2:
        image.encoding = rng.choice(TEXTS)
        return Message(image, image.encoding not in ("16UC1", "mono16", "32FC1"))
    if kind == 3:
        image.step = rng.choice((0, 1, SMALL_WIDTH * size - 1, *COUNTS[:6]))
        return Message(image, image.step < SMALL_WIDTH * size)
    if kind == 4:
        setattr(image, rng.choice(("width", "height", "step")), rng.choice(COUNTS[6:]))
        return Message(image, True)
    if kind == 5:
        image.width, image.height, image.step = (rng.choice(COUNTS) for _ in range(3))
        return Message(image)
    if kind == 6:  # every length shorter than the pixels need
        image.data = _bytes_of(bytes(number // 10 % (SMALL_WIDTH * SMALL_HEIGHT * size)))
        return Message(image, True)
    if kind == 7:
        image.data = _bytes_of(rng.randbytes(len(image.data) + rng.randrange(9)))
        image.is_bigendian = rng.choice((0, 1, 2, 255))
        return Message(image)
    if kind == 8:
        _header(rng, image)
        return Message(image)
    side = rng.choice((1, 7, 64, 300) if rng.random() < 0.98 else (2048,))  # the last is larger than the bounds
    image.width = image.height = side
    image.step, image.data = side * size, _bytes_of(bytes(side * side * size))
    return Message(image)


# Packed depth images


_FORMATS = (
    "",
    ";",
    "png",
    "16UC1;",
    "16UC1; compressedDepth zstd",
    "16UC1; png",
    "rgb8; compressedDepth png",
    "a" * 3000,
)


def _packed_good(stamp: int) -> Sequence[Any]:
    return (compressed_msg(wall(), stamp, SENDER, "rvl"),)


def _packed_make(rng: random.Random, number: int) -> Message:
    codec = rng.choice(("png", "rvl"))
    steps = np.random.default_rng(number % 64).integers(0, 4000, (SMALL_HEIGHT, SMALL_WIDTH))
    depth = steps.astype(np.uint16) if rng.random() < 0.5 else (steps * 1e-3).astype(np.float32)
    packed = compressed_msg(depth, _stamp(number), SENDER, codec)
    data, head = bytearray(packed.data), 12
    kind = number % 10
    if kind < 2:
        return _mangled(rng, number, packed)
    if kind == 2:
        packed.format = rng.choice(_FORMATS)
        return Message(packed, True)
    if kind == 3:  # every length; after the last pixel a PNG has checksums and an end mark
        del data[number // 10 % (len(data) - (20 if codec == "png" else 0)) :]
        bad = True
    elif kind == 4:  # columns and rows
        width, height = rng.choice(COUNTS[6:]), rng.choice(COUNTS)
        struct.pack_into(">II" if codec == "png" else "<II", data, head + (16 if codec == "png" else 0), width, height)
        bad = True
    elif kind == 5:
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(head, len(data))] = rng.randrange(256)
        bad = False
    elif kind == 6:
        struct.pack_into("<iff", data, 0, rng.choice((-1, 0, 7)), *(rng.choice(FLOATS) for _ in range(2)))
        bad = False
    elif kind == 7:
        data[head + 8 :] = rng.randbytes(rng.randrange(4000))
        bad = codec == "png"
    elif kind == 8:
        data += bytes(rng.choice((1, 4, 1000, 1_000_000)))
        bad = False
    else:
        _header(rng, packed)
        return Message(packed)
    packed.data = _bytes_of(bytes(data))
    return Message(packed, bad)


# camera_info


def _info_good(stamp: int) -> Sequence[Any]:
    return (info_msg(64, 48, stamp, frame=SENDER),)


def _info_make(rng: random.Random, number: int) -> Message:
    info = info_msg(SMALL_WIDTH, SMALL_HEIGHT, _stamp(number), frame=SENDER)
    kind = number % 8
    if kind < 2:
        return _mangled(rng, number, info)
    if kind == 2:
        info.k[0] = info.p[0] = 0.0
        return Message(info, True)
    if kind == 3:
        info.p[rng.choice((0, 5))] = rng.choice((float("nan"), float("inf"), -1.0, -1e308))
        return Message(info, True)
    if kind == 4:
        setattr(info, rng.choice(("width", "height")), rng.choice([c for c in COUNTS if c != 16]))
        return Message(info, True)
    if kind == 5:
        matrix = rng.choice((info.k, info.p))
        matrix[rng.randrange(len(matrix))] = rng.choice(NUMBERS)
        return Message(info)
    if kind == 6:
        info.d = [rng.choice(NUMBERS) for _ in range(rng.choice((0, 1, 5, 1000)))]
        info.distortion_model = rng.choice(TEXTS)
        return Message(info)
    info.binning_x, info.binning_y = rng.choice(COUNTS), rng.choice(COUNTS)
    info.roi.width, info.roi.x_offset = rng.choice(COUNTS), rng.choice(COUNTS)
    return Message(info)


def _lens_make(rng: random.Random, number: int) -> Message:
    """camera_info of a raw image: K and D count, P does not."""
    if number % 3 == 0:
        message = _info_make(rng, number)
        return Message(message.payload, message.bad and number % 8 != 3)
    info = info_msg(SMALL_WIDTH, SMALL_HEIGHT, _stamp(number), frame=SENDER)
    info.distortion_model = rng.choice((*COUNTS_OF, rng.choice(TEXTS)))
    counts = COUNTS_OF.get(info.distortion_model, ())
    count = rng.choice((*counts, rng.choice((0, 1, 4, 5, 8, 12, 14, 1000))))
    numbers = rng.choice((NUMBERS, (0.0, 0.01, -0.02), (0.3, -0.3, 2.0, -2.0), (1e9, -1e9, 1e-300)))
    info.d = [rng.choice(numbers) for _ in range(count)]
    nothing = info.distortion_model != "equidistant" and not any(info.d)
    wrong = count not in counts or not np.isfinite(info.d).all()
    return Message(info, count > 0 and wrong and not nothing)


# Meshes


def _mesh_good(_stamp: int) -> Sequence[Any]:
    return (encode_mesh(*plate()),)


def _mesh_make(rng: random.Random, number: int) -> Message:
    vertices, triangles = plate()
    little = number % 2 == 0
    kind = number // 2 % 8
    if kind == 0:
        return Message(any_bytes(rng))
    if kind <= 2:
        return Message(mutated(rng, encode_mesh(vertices, triangles, little)))
    if kind == 3:  # cut at every byte
        data = encode_mesh(vertices, triangles, little)
        return Message(data[: number // 16 % len(data)], True)
    if kind == 4:
        data = bytearray(encode_mesh(vertices, triangles, little))
        struct.pack_into(
            "<I" if little else ">I", data, rng.choice((4, 8 + triangles.size * 4)), rng.choice(COUNTS[5:])
        )
        return Message(bytes(data), True)
    if kind == 5:
        vertices.flat[rng.randrange(vertices.size)] = rng.choice(NUMBERS[:3])
        return Message(encode_mesh(vertices, triangles, little), True)
    if kind == 6:
        triangles.flat[rng.randrange(triangles.size)] = rng.choice((4, 5, 2**31 - 1, 2**31, 2**32 - 1))
        return Message(encode_mesh(vertices, triangles, little), True)
    vertices.flat[rng.randrange(vertices.size)] = rng.choice(NUMBERS[3:])
    return Message(encode_mesh(vertices, triangles, little))


# Markers


def _soup() -> np.ndarray:
    vertices, triangles = plate()
    return vertices[triangles].reshape(-1, 3)


def _marker(**changes: Any) -> MarkerMessage:
    return MarkerMessage(**{"ns": "good", "id": 7, "frame": SENDER, "points": _soup(), **changes})


def _strange_marker(rng: random.Random) -> tuple[MarkerMessage, bool]:
    """A marker with one strange field, and whether it must be refused."""
    points = _soup()
    kind = rng.randrange(9)
    if kind == 0:
        points[rng.randrange(len(points)), rng.randrange(3)] = rng.choice(NUMBERS[:3])
        return _marker(points=points), True
    if kind == 1:
        return _marker(points=points[: rng.choice((1, 2, 4, 5))]), True
    if kind == 2:
        pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        pose[rng.randrange(7)] = rng.choice(NUMBERS)
        return _marker(position=tuple(pose[:3]), orientation=tuple(pose[3:])), False
    if kind == 3:
        scale = [1.0, 1.0, 1.0]
        scale[rng.randrange(3)] = rng.choice(NUMBERS)
        return _marker(scale=tuple(scale)), False
    if kind == 4:
        action = rng.choice((-1, 1, 4, 2**31 - 1, -(2**31)))
        return _marker(action=action), True
    if kind == 5:
        return _marker(type=rng.choice((0, 5, 10, 12, -1, 2**31 - 1)), action=rng.choice((0, 2, 3))), False
    if kind == 6:
        return _marker(
            ns=rng.choice(TEXTS), id=rng.choice((-(2**31), -1, 0, 2**31 - 1)), frame=rng.choice(TEXTS)
        ), False
    if kind == 7:
        stamp, lifetime = (rng.randrange(-(2**31), 2**31) * 10**9 + rng.randrange(10**9) for _ in range(2))
        return _marker(stamp=stamp, lifetime=lifetime, frame_locked=rng.random() < 0.5), False
    points[rng.randrange(len(points)), rng.randrange(3)] = rng.choice(NUMBERS[3:])
    return _marker(points=points), False


def _markers_good(_stamp: int) -> Sequence[Any]:
    return (encode_markers([_marker(action=3, ns=""), _marker()]),)


def _marker_good(_stamp: int) -> Sequence[Any]:
    return encode_marker(_marker(action=3, ns="")), encode_marker(_marker())


def _marker_bytes(rng: random.Random, number: int, encode: Callable[[bool], bytes]) -> Message:
    data = encode(number % 2 == 0)
    kind = number // 2 % 5
    if kind == 0:
        return Message(any_bytes(rng, 900))
    if kind == 1:  # cut at every byte
        return Message(data[: number // 10 % len(data)], True)
    if kind == 2:  # a count of points, colors or characters that cannot be
        changed = bytearray(data)
        place = 4 + 4 * rng.randrange((len(data) - 4) // 4)
        struct.pack_into("<I" if data[1] else ">I", changed, place, rng.choice(COUNTS[5:]))
        return Message(bytes(changed))
    return Message(mutated(rng, data, 260))


def _marker_make(rng: random.Random, number: int) -> Message:
    if number % 3 == 0:
        marker, bad = _strange_marker(rng)
        return Message(encode_marker(marker, rng.random() < 0.5), bad)
    return _marker_bytes(rng, number // 3, lambda little: encode_marker(_marker(), little))


def _markers_make(rng: random.Random, number: int) -> Message:
    if number % 3 == 0:
        listed = [_strange_marker(rng) for _ in range(rng.randrange(1, 4))]
        bad = len(listed) == 1 and listed[0][1]
        return Message(encode_markers([marker for marker, _ in listed], rng.random() < 0.5), bad)
    few = [_marker(id=n) for n in range(2)]
    return _marker_bytes(rng, number // 3, lambda little: encode_markers(few, little))


# Point clouds


def cloud_msg(points: np.ndarray, stamp: int, frame: str = SENDER) -> PointCloud2:
    """A cloud of x, y, z float32; (N, 3) metres."""
    cloud = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points), is_dense=True)
    cloud.fields = [PointField(name=name, offset=4 * n, datatype=7, count=1) for n, name in enumerate("xyz")]
    cloud.header.stamp, cloud.header.frame_id = time_msg(stamp), frame
    cloud.data = _bytes_of(np.ascontiguousarray(points, "<f4").tobytes())
    return cloud


def _cloud_good(stamp: int) -> Sequence[Any]:
    return (cloud_msg(_soup(), stamp),)


def _cloud_make(rng: random.Random, number: int) -> Message:
    points = _soup()
    cloud = cloud_msg(points, _stamp(number))
    kind = number % 9
    if kind < 2:
        return _mangled(rng, number, cloud)
    if kind == 2:
        place = rng.randrange(3)
        cloud.fields[place].offset = rng.choice(COUNTS[4:])
        return Message(cloud, True)
    if kind == 3:
        cloud.fields[rng.randrange(3)].datatype = rng.choice((0, 1, 2, 3, 4, 5, 6, 9, 255))
        return Message(cloud, True)
    if kind == 4:
        cloud.fields[rng.randrange(3)].name = rng.choice(("", "X", "intensity", "a" * 3000))
        return Message(cloud, True)
    if kind == 5:
        setattr(cloud, rng.choice(("width", "height", "point_step", "row_step")), rng.choice(COUNTS))
        return Message(cloud)
    if kind == 6:
        cloud.data = _bytes_of(bytes(number // 9 % len(cloud.data)))
        return Message(cloud, True)
    if kind == 7:
        points[rng.randrange(len(points)), rng.randrange(3)] = np.clip(rng.choice(NUMBERS), -3e38, 3e38)
        return Message(cloud_msg(points, 10**12))
    cloud.is_bigendian, cloud.is_dense = rng.random() < 0.5, rng.random() < 0.5
    _header(rng, cloud)
    return Message(cloud)


def add_normals(cloud: PointCloud2, axes: str = "xyz", datatype: int = 7, offset: int = 0) -> PointCloud2:
    """The cloud, its coordinates being its normals as well."""
    made = [
        PointField(name=f"normal_{axis}", offset=offset + 4 * "xyz".index(axis), datatype=datatype, count=1)
        for axis in axes
    ]
    cloud.fields = [*cloud.fields, *made]
    return cloud


def _query_make(rng: random.Random, number: int) -> Message:
    """Half of the clouds have normals, whole or not."""
    message = _cloud_make(rng, number)
    cloud = message.payload
    if not isinstance(cloud, PointCloud2) or rng.random() < 0.5:
        return message
    axes, datatype = rng.choice(("xyz", "xyz", "xyz", "xy", "z", "xyzz")), rng.choice((7, 7, 7, 8, 5, 255))
    offset = rng.choice((0, 0, 0, 1, 2**31))
    bad = (axes, datatype, offset) != ("xyz", 7, 0) and cloud.width * cloud.height > 0
    return Message(add_normals(cloud, axes, datatype, offset), message.bad or bad)


# Poses


def pose_msg(stamp: int, frame: str = SENDER, position: Sequence[float] = (0.0, 0.0, 0.0)) -> PoseStamped:
    """A pose without rotation."""
    pose = PoseStamped()
    pose.header.stamp, pose.header.frame_id = time_msg(stamp), frame
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = position
    pose.pose.orientation.w = 1.0
    return pose


def _pose_make(frame: str) -> Callable[[random.Random, int], Message]:
    def make(rng: random.Random, number: int) -> Message:
        pose = pose_msg(_stamp(number), frame)
        kind = number % 5
        if kind < 2:
            return _mangled(rng, number, pose)
        if kind == 2:
            setattr(pose.pose.position, rng.choice("xyz"), rng.choice(NUMBERS[:3]))
            return Message(pose, True)
        if kind == 3:
            setattr(pose.pose.orientation, rng.choice("xyzw"), rng.choice((float("nan"), float("inf"), 0.5, 1e308)))
            return Message(pose, True)
        _header(rng, pose)
        return Message(pose)

    return make


LAMP = (0.5, -0.5, 0.0)
_TOPIC_POSE = {"pose_source": "topic", "fixed_frame": "world"}

INPUTS = (
    Input("depth image", "depth/image_rect", _depth_good, _depth_make, parameters={"camera_info_policy": "latest"}),
    Input("compressedDepth", "depth/image_rect/compressedDepth", _packed_good, _packed_make, codec="png",
          parameters={"camera_info_policy": "latest", "depth_image_transport": "compressedDepth"}),
    Input("camera_info", "depth/camera_info", _info_good, _info_make, with_image=True,
          parameters={"camera_info_policy": "exact"}),
    Input("lens", "depth/camera_info", _info_good, _lens_make, with_image=True,
          parameters={"camera_info_policy": "exact", "distortion": "apply"}),
    Input("mesh", "mesh", _mesh_good, _mesh_make),
    Input("mesh_marker", "mesh_marker", _marker_good, _marker_make),
    Input("mesh_markers", "mesh_markers", _markers_good, _markers_make),
    Input("mesh_cloud", "mesh_cloud", _cloud_good, _cloud_make),
    Input("camera_pose", "camera_pose", lambda stamp: (pose_msg(stamp, "world"),), _pose_make("world"),
          with_frame=True, parameters=_TOPIC_POSE),
    Input("light pose", "shadow_tracer/lights/lamp/pose",
          lambda stamp: (pose_msg(stamp, SENDER, LAMP),), _pose_make(SENDER)),
    Input("query", "query", _cloud_good, _query_make),
)  # fmt: skip


def small_frame(number: int) -> Image:
    """The depth image that a camera_info of this number belongs to."""
    return image_msg(np.full((SMALL_HEIGHT, SMALL_WIDTH), 2.0, np.float32), _stamp(number), SENDER)
