# SPDX-License-Identifier: Apache-2.0
"""visualization_msgs/Marker and MarkerArray, as ROS 2 Jazzy lays them out, as raw CDR bytes <-> numpy.

Only what a shadow depends on is kept; the rest is stepped over, but completely: a message that does not end where it
should has another layout. What the fields mean is in :mod:`markers`. No ROS here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.cdr_reader import MeshMessageError, Reader, Writer

ARROW, SPHERE, LINE_LIST, TEXT, TRIANGLE_LIST = 0, 2, 5, 9, 11
ADD, DELETE, DELETEALL = 0, 2, 3

LEAST = 189  # bytes that any marker takes, whatever its strings and sequences
_BILLION = 1_000_000_000
_PLACEMENT = "10d4fiIB"  # position, orientation, scale, color, lifetime, frame_locked: no gaps between them
# What follows the colors where it is empty, as it mostly is: it can be read at once. A string is its length and a zero.
_STRING = "IB3x"
_REST = f"{_STRING}iI{_STRING}{_STRING}II{_STRING}{_STRING}{_STRING}IB"
_EMPTY = {0: 1, 4: 1, 6: 1, 8: 0, 9: 0, 10: 1, 12: 1, 14: 1, 16: 0}  # place and value of each count


def _no_points() -> npt.NDArray[np.float64]:
    return np.empty((0, 3))


def _no_colors() -> npt.NDArray[np.float32]:
    return np.empty((0, 4), np.float32)


@dataclass(frozen=True, eq=False)
class MarkerMessage:
    """A marker.

    Attributes:
        ns, id: its name.
        type: what it shows; 11 is TRIANGLE_LIST.
        action: 0 add or modify, 2 delete, 3 delete all.
        frame: frame_id of the header.
        stamp: of the header [ns].
        position, orientation: its pose [m], quaternion x y z w.
        scale: factors along x, y and z.
        color: r, g, b, a from 0 to 1.
        lifetime: how long it stays [ns].
        frame_locked: it moves with its frame.
        points: (N, 3) float64 [m], in any byte order; may be a read-only view of the message that is not aligned.
        text: what it says; written, never read.
        colors: (N, 4) float32 r, g, b, a of each point, or (0, 4); written, never read.
    """

    ns: str = ""
    id: int = 0
    type: int = TRIANGLE_LIST
    action: int = ADD
    frame: str = ""
    stamp: int = 0
    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    orientation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)
    color: tuple[float, ...] = (0.7, 0.7, 0.7, 1.0)
    lifetime: int = 0
    frame_locked: bool = False
    points: npt.NDArray[np.float64] = field(default_factory=_no_points)
    text: str = ""
    colors: npt.NDArray[np.float32] = field(default_factory=_no_colors)


CLEARED = MarkerMessage(action=DELETEALL)


def parse_marker(data: bytes, max_triangles: int) -> MarkerMessage:
    """Parse the bytes of a visualization_msgs/Marker.

    Args:
        data: the serialised message, little or big endian; any bytes are survived.
        max_triangles: largest number of triangles accepted.

    Raises:
        MeshMessageError: truncated, too large, not plain CDR, bytes left over.
    """
    reader = Reader(data)
    marker = _read(reader)
    reader.finish("mesh_use_embedded_materials", "visualization_msgs/Marker")
    check_size([marker], max_triangles)
    return marker


def parse_markers(data: bytes, max_triangles: int) -> list[MarkerMessage]:
    """Parse the bytes of a visualization_msgs/MarkerArray.

    Args:
        data: the serialised message, little or big endian; any bytes are survived.
        max_triangles: largest number of triangles of all markers together.

    Raises:
        MeshMessageError: truncated, too large, not plain CDR, bytes left over.
    """
    reader = Reader(data)
    count = reader.count("markers")
    if count * LEAST > reader.left:
        raise MeshMessageError(
            f"markers: {count} of them need at least {count * LEAST} bytes, but {reader.left} are left"
        )
    markers = []
    for number in range(count):
        reader.scope = f"markers[{number}]."
        markers.append(_read(reader))
    reader.scope = ""
    reader.finish("markers", "visualization_msgs/MarkerArray")
    check_size(markers, max_triangles)
    return markers


def check_size(markers: Iterable[MarkerMessage], max_triangles: int) -> None:
    """Refuse the markers of one message if their lists have more triangles together than a scene may have.

    Raises:
        MeshMessageError: they have.
    """
    total = sum(len(marker.points) for marker in markers if marker.action == ADD and marker.type == TRIANGLE_LIST) // 3
    if total > max_triangles:
        raise MeshMessageError(
            f"bounds.max_triangles: the markers have {total} triangles, the bound is {max_triangles}"
        )


def _read(reader: Reader) -> MarkerMessage:
    seconds, nanoseconds = reader.numbers("iI", 4, "header.stamp")
    frame = reader.text("header.frame_id")
    ns = reader.text("ns")
    marker_id, kind, action = reader.numbers("3i", 4, "id, type, action")
    values = reader.numbers(_PLACEMENT, 8, "pose, scale, color, lifetime, frame_locked")
    if values[16] > 1:
        raise MeshMessageError(f"{reader.scope}frame_locked: expected 0 or 1, got {values[16]}")
    points = reader.array(reader.count("points"), 3, "f8", "points")
    _skip_rest(reader)
    return MarkerMessage(
        ns,
        marker_id,
        kind,
        action,
        frame,
        seconds * _BILLION + nanoseconds,
        values[:3],
        values[3:7],
        values[7:10],
        values[10:14],
        values[14] * _BILLION + values[15],
        bool(values[16]),
        points,
    )


def _skip_rest(reader: Reader) -> None:
    reader.skip_sequence(16, 4, "colors")
    rest = reader.peek(_REST, 4)
    if rest is not None and all(rest[place] == count for place, count in _EMPTY.items()) and rest[17] < 2:
        reader.numbers(_REST, 4, "mesh_use_embedded_materials")
        return
    reader.skip_sequence(1, 1, "texture_resource")
    reader.numbers("iI", 4, "texture.header.stamp")
    reader.skip_sequence(1, 1, "texture.header.frame_id")
    reader.skip_sequence(1, 1, "texture.format")
    reader.skip_sequence(1, 1, "texture.data")
    reader.skip_sequence(8, 4, "uv_coordinates")
    reader.skip_sequence(1, 1, "text")
    reader.skip_sequence(1, 1, "mesh_resource")
    reader.skip_sequence(1, 1, "mesh_file.filename")
    reader.skip_sequence(1, 1, "mesh_file.data")
    reader.flag("mesh_use_embedded_materials")


def encode_marker(marker: MarkerMessage, little: bool = True) -> bytes:
    """Bytes of a visualization_msgs/Marker, ready for ``publisher.publish(bytes)``.

    Args:
        little: byte order of the message.

    Raises:
        ValueError: points are not (N, 3).
        struct.error: a number is too large for its field.
    """
    writer = Writer(little)
    _write(writer, marker)
    return writer.message()


def encode_markers(markers: Iterable[MarkerMessage], little: bool = True) -> bytes:
    """Bytes of a visualization_msgs/MarkerArray; see :func:`encode_marker`."""
    listed = list(markers)
    writer = MarkersWriter(len(listed), little)
    for marker in listed:
        writer.add(marker)
    return writer.message()


class MarkersWriter:
    """Writes a visualization_msgs/MarkerArray one marker after the other, for those who cannot do it all at once.

    Args:
        count: how many will be added.
        little: byte order of the message.
    """

    def __init__(self, count: int, little: bool = True) -> None:
        self._left = count
        self._writer = Writer(little)
        self._writer.numbers("I", 4, count)

    def add(self, marker: MarkerMessage) -> None:
        """Append one; see :func:`encode_marker`."""
        _write(self._writer, marker)
        self._left -= 1

    def message(self) -> bytes:
        """The bytes. Raises ValueError if another number was added than was said."""
        if self._left:
            raise ValueError(f"count: expected the markers that were added, got {self._left:+d} of them")
        return self._writer.message()


def _write(writer: Writer, marker: MarkerMessage) -> None:
    points = np.asarray(marker.points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected shape (N, 3), got {points.shape}")
    writer.numbers("iI", 4, *divmod(marker.stamp, _BILLION))
    writer.text(marker.frame)
    writer.text(marker.ns)
    writer.numbers("3i", 4, marker.id, marker.type, marker.action)
    placement = (*marker.position, *marker.orientation, *marker.scale, *marker.color)
    writer.numbers(_PLACEMENT, 8, *placement, *divmod(marker.lifetime, _BILLION), marker.frame_locked)
    writer.array(points, "f8")
    writer.array(np.asarray(marker.colors), "f4")
    writer.text("")  # texture_resource
    writer.numbers("iI", 4, 0, 0)  # texture
    writer.text("")
    writer.text("")
    writer.numbers("I", 4, 0)
    writer.numbers("I", 4, 0)  # uv_coordinates
    writer.text(marker.text)
    writer.text("")  # mesh_resource
    writer.text("")  # mesh_file
    writer.numbers("I", 4, 0)
    writer.numbers("B", 1, 0)  # mesh_use_embedded_materials
