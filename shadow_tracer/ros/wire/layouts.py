# SPDX-License-Identifier: Apache-2.0
"""Raw messages parsed here, or by ROS where its layout is another one.

At the start small messages of each type are serialised by ROS and parsed by :mod:`cdr` and :mod:`cdr_markers`. A type
that does not come out as it went in is from then on turned into objects by ROS, which takes hundreds of times longer
but is right (of grid maps, which nobody lays out differently, none is read then). Without ROS, as when a bag is read,
there is nothing to compare with, and nothing else to parse by.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.cdr import MeshMessage, encode_mesh, parse_mesh
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, check_size, parse_marker, parse_markers
from shadow_tracer.ros.wire.cdr_reader import HEADER, LONGEST_NAME, MeshMessageError
from shadow_tracer.ros.wire.grid_map import GRID_MAP, GridMap, encode_grid_map, parse_grid_map
from shadow_tracer.ros.wire.messages import stamp_ns

MESH, MARKER, MARKERS = "shape_msgs/msg/Mesh", "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray"
CLOUD = "sensor_msgs/msg/PointCloud2"
_LEAST_MARKER = 64  # bytes that a marker of any layout takes


class Layouts:
    """The parsers of raw messages.

    Attributes:
        reasons: why messages of a type go through objects, by the name of the type; "" where they do not.
    """

    def __init__(self) -> None:
        self.reasons = dict.fromkeys((MESH, MARKER, MARKERS, GRID_MAP), "")

    def check(self) -> dict[str, str]:
        """Compare the parsers with ROS, some milliseconds. Returns :attr:`reasons`."""
        checks = {
            MESH: _mesh_differs, MARKER: _marker_differs, MARKERS: _markers_differ, GRID_MAP: _grid_map_differs,
        }  # fmt: skip
        for name, different in checks.items():
            try:
                where = different()
            except ImportError:
                continue  # no ROS, or none with this type: then it cannot arrive either
            except MeshMessageError as error:
                where = str(error)
            if where:
                then = "cannot be read" if name == GRID_MAP else "is read as objects, which is slow"
                where = f"{name} is laid out differently by this ROS ({where}); it {then}"
            self.reasons[name] = where
        return dict(self.reasons)

    def mesh(self, data: bytes, max_triangles: int, known: MeshMessage | None = None) -> MeshMessage:
        """A shape_msgs/Mesh; see :func:`cdr.parse_mesh`."""
        if not self.reasons[MESH]:
            return parse_mesh(data, max_triangles, known)
        return mesh_from(_object(data, MESH), max_triangles, known)

    def marker(self, data: bytes, max_triangles: int) -> MarkerMessage:
        """A visualization_msgs/Marker; see :func:`cdr_markers.parse_marker`."""
        if not self.reasons[MARKER]:
            return parse_marker(data, max_triangles)
        marker = marker_from(_object(data, MARKER))
        check_size([marker], max_triangles)
        return marker

    def markers(self, data: bytes, max_triangles: int) -> list[MarkerMessage]:
        """A visualization_msgs/MarkerArray; see :func:`cdr_markers.parse_markers`."""
        if not self.reasons[MARKERS]:
            return parse_markers(data, max_triangles)
        # ROS makes room for as many markers as are announced, hundreds of bytes each, before it looks for them.
        announced = _announced(data)
        if announced * _LEAST_MARKER > len(data):
            raise MeshMessageError(f"markers: {announced} of them do not fit into {len(data)} bytes")
        markers = [marker_from(marker) for marker in _object(data, MARKERS).markers]
        check_size(markers, max_triangles)
        return markers

    def grid_map(self, data: bytes, layer: str, max_triangles: int) -> GridMap:
        """A layer of a grid_map_msgs/GridMap; see :func:`grid_map.parse_grid_map`."""
        if not self.reasons[GRID_MAP]:
            return parse_grid_map(data, layer, max_triangles)
        raise MeshMessageError(f"message: {self.reasons[GRID_MAP]}")

    @staticmethod
    def cloud(data: bytes) -> Any:
        """A sensor_msgs/PointCloud2 as an object, which costs next to nothing. Raises MeshMessageError."""
        return _object(data, CLOUD)


def _announced(data: bytes) -> int:
    """The count with which an array starts, in the byte order that the last bit of the encapsulation gives."""
    little = len(data) > 1 and data[1] & 1
    return int.from_bytes(data[HEADER : HEADER + 4], "little" if little else "big")


def _object(data: bytes, kind: str) -> Any:
    """The message as ROS reads it. Raises MeshMessageError whatever it dislikes."""
    from rclpy.serialization import deserialize_message

    try:
        return deserialize_message(data, _type(kind))
    except Exception as error:  # RMWError, and what other middleware may raise
        raise MeshMessageError(f"message: ROS cannot read it as {kind}: {str(error)[:200]}") from None


def _type(kind: str) -> Any:
    if kind == MESH:
        from shape_msgs.msg import Mesh

        return Mesh
    if kind == CLOUD:
        from sensor_msgs.msg import PointCloud2

        return PointCloud2
    from visualization_msgs.msg import Marker, MarkerArray

    return Marker if kind == MARKER else MarkerArray


def mesh_from(message: Any, max_triangles: int, known: MeshMessage | None = None) -> MeshMessage:
    """A shape_msgs/Mesh object as :func:`cdr.parse_mesh` gives it, with the same checks."""
    triangles = _rows((triangle.vertex_indices for triangle in message.triangles), np.uint32)
    vertices = _rows(((point.x, point.y, point.z) for point in message.vertices), np.float64)
    return parse_mesh(encode_mesh(vertices, triangles), max_triangles, known)


def marker_from(message: Any) -> MarkerMessage:
    """A visualization_msgs/Marker object as :func:`cdr_markers.parse_marker` gives it.

    Raises:
        MeshMessageError: a name is too long.
    """
    for field, text in (("header.frame_id", message.header.frame_id), ("ns", message.ns)):
        length = len(text.encode()) + 1  # serialised, it ends in a zero
        if length > LONGEST_NAME:
            raise MeshMessageError(f"{field}: expected at most {LONGEST_NAME} bytes, got {length}")
    position, orientation, scale, color = message.pose.position, message.pose.orientation, message.scale, message.color
    return MarkerMessage(
        ns=message.ns,
        id=message.id,
        type=message.type,
        action=message.action,
        frame=message.header.frame_id,
        stamp=stamp_ns(message.header.stamp),
        position=(position.x, position.y, position.z),
        orientation=(orientation.x, orientation.y, orientation.z, orientation.w),
        scale=(scale.x, scale.y, scale.z),
        color=(color.r, color.g, color.b, color.a),
        lifetime=stamp_ns(message.lifetime),
        frame_locked=bool(message.frame_locked),
        points=_rows(((point.x, point.y, point.z) for point in message.points), np.float64),
    )


def _rows(rows: Any, kind: Any) -> Any:
    return np.array(list(rows), kind).reshape(-1, 3)


def _mesh_differs() -> str:
    """Where our parser and ROS disagree about meshes, "" if nowhere."""
    from geometry_msgs.msg import Point
    from rclpy.serialization import serialize_message
    from shape_msgs.msg import Mesh, MeshTriangle

    for count in range(3):  # with and without the gap before the vertices, and without vertices
        message = Mesh()
        message.triangles = [MeshTriangle(vertex_indices=[0, k, 2]) for k in range(count)]
        message.vertices = [Point(x=1.5 + k, y=-2.5, z=3e-300) for k in range(3 if count else 0)]
        ours, theirs = parse_mesh(serialize_message(message), 10), mesh_from(message, 10)
        if not (np.array_equal(ours.triangles, theirs.triangles) and np.array_equal(ours.vertices, theirs.vertices)):
            return f"{count} triangles differ"
    return ""


def _samples() -> list[Any]:
    """Markers that differ in everything, with strings and sequences of lengths that leave gaps behind them."""
    from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
    from std_msgs.msg import ColorRGBA
    from visualization_msgs.msg import Marker, UVCoordinate

    samples = []
    for number in range(4):
        marker = Marker(ns="n" * (3 * number), id=-number, type=11, action=number, frame_locked=number % 2 == 1)
        marker.header.frame_id = "frame"[: 1 + number]
        marker.header.stamp.sec, marker.header.stamp.nanosec = 1_700_000_000 + number, 999_999_999
        marker.lifetime.sec, marker.lifetime.nanosec = -number, 5 + number
        marker.pose = Pose(position=Point(x=1.5, y=2.5, z=3.5), orientation=Quaternion(x=0.1, y=0.2, z=0.3, w=0.4))
        marker.scale = Vector3(x=4.5, y=5.5, z=6.5)
        marker.color = ColorRGBA(r=0.25, g=0.5, b=0.75, a=1.0)
        marker.points = [Point(x=7.5 + k, y=8.5, z=9.5) for k in range(number)]
        marker.colors = [ColorRGBA()] * number
        marker.texture_resource = marker.text = marker.mesh_resource = "t" * (number + 1)
        marker.texture.header.frame_id = marker.texture.format = "p" * (2 * number)
        marker.texture.data = marker.mesh_file.data = bytes(number)
        marker.uv_coordinates = [UVCoordinate()] * number
        marker.mesh_file.filename = "m" * (4 + number)
        samples.append(marker)
    return samples


def _differ(ours: Sequence[MarkerMessage], theirs: Sequence[MarkerMessage]) -> str:
    if len(ours) != len(theirs):
        return f"{len(theirs)} markers came out as {len(ours)}"
    for mine, other in zip(ours, theirs, strict=True):
        for field in MarkerMessage.__dataclass_fields__:
            if not np.array_equal(getattr(mine, field), getattr(other, field)):
                return f"{field} {getattr(other, field)!r} came out as {getattr(mine, field)!r}"
    return ""


def _marker_differs() -> str:
    """Where our parser and ROS disagree about single markers, "" if nowhere."""
    return _compare(_samples(), lambda data: [parse_marker(data, 10)], lambda message: [marker_from(message)])


def _markers_differ() -> str:
    """Where our parser and ROS disagree about arrays of markers, "" if nowhere."""
    from visualization_msgs.msg import MarkerArray

    samples = _samples()
    arrays = [MarkerArray(markers=samples[:count]) for count in range(len(samples) + 1)]
    return _compare(
        arrays,
        lambda data: parse_markers(data, 10),
        lambda message: [marker_from(marker) for marker in message.markers],
    )


def _grid_map_differs() -> str:
    """Where our parser and ROS disagree about grid maps, "" if nowhere."""
    from rclpy.serialization import deserialize_message, serialize_message

    kind = grid_map_type()
    if kind is None:
        raise ImportError(GRID_MAP)
    for number in range(4):  # with names of lengths that leave gaps behind them
        values = np.arange(6, dtype=np.float32).reshape(2, 3) + number
        ours = GridMap("f" * number, 7_000_000_009, 0.25, (1.5, -2.5), values)
        layers = {"l" * (number + 1): values, "elevation": -values}
        data = encode_grid_map(ours, layers, ["b" * number] * number, starts=(1, 2))
        message = deserialize_message(data, kind)
        same = (
            message.header.frame_id == ours.frame and list(message.layers) == list(layers)
            and (message.outer_start_index, message.inner_start_index) == (1, 2)
            and (message.info.resolution, message.info.length_x, message.info.length_y) == (0.25, 0.5, 0.75)
            and (message.info.pose.position.x, message.info.pose.position.y) == ours.center
        )  # fmt: skip
        theirs = parse_grid_map(serialize_message(message), "elevation", 10)
        if not same or not np.array_equal(theirs.values, -values):
            return f"a map with {len(layers)} layers differs"
    return ""


def grid_map_type() -> Any:
    """The class grid_map_msgs.msg.GridMap; None where there is none: the package index has no such package."""
    try:
        return importlib.import_module("grid_map_msgs.msg").GridMap
    except ImportError:
        return None


def _compare(
    messages: Sequence[Any],
    ours: Callable[[bytes], Sequence[MarkerMessage]],
    theirs: Callable[[Any], Sequence[MarkerMessage]],
) -> str:
    from rclpy.serialization import serialize_message

    return next(filter(None, (_differ(ours(serialize_message(one)), theirs(one)) for one in messages)), "")
