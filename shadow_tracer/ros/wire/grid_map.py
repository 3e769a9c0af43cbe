# SPDX-License-Identifier: Apache-2.0
"""grid_map_msgs/GridMap as raw CDR bytes <-> numpy. No ROS here, and no grid_map_msgs, which the package index has not.

A map is a rectangle of R x C square cells. Row 0 is the one with the largest x, column 0 that with the largest y, and
the pose of the message is the middle of all cells. A layer is one float32 per cell, column by column, in a ring buffer:
the cell that is stored at row r, column c stands at row r - ``outer_start_index``, column c - ``inner_start_index``, up
to multiples of R and C.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.cdr_reader import MeshMessageError, Reader, Writer
from shadow_tracer.ros.wire.parts import Changes, Part
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.scene.surface import HeightField, Organised, organised

GRID_MAP = "grid_map_msgs/msg/GridMap"
KEY = "grid_map"
# Fields of the types as ROS 2 has them, for bags.
GRID_MAP_INFO = "grid_map_msgs/msg/GridMapInfo"
DEFINITIONS = {
    GRID_MAP_INFO: ("float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"),
    GRID_MAP: (
        "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\nstring[] layers\nstring[] basic_layers\n"
        "std_msgs/Float32MultiArray[] data\nuint16 outer_start_index\nuint16 inner_start_index\n"
    ),
}

_STORED = ("column_index", "row_index")  # labels of the dimensions of a layer, the outer one first
_TURN = 1e-6  # a quaternion with components below this turns nothing
_FINEST, _COARSEST = 1e-9, 1e9  # resolution [m], as of a HeightField

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class GridMap:
    """A layer of a map.

    Attributes:
        frame: of the header.
        stamp: of the header [ns].
        resolution: edge of a cell [m].
        center: x, y of the middle of all cells [m].
        values: (R, C) float32, row 0 at the largest x, column 0 at the largest y; NaN where there is none.
    """

    frame: str
    stamp: int
    resolution: float
    center: tuple[float, float]
    values: Floats

    @property
    def corner(self) -> tuple[float, float]:
        """x, y of the middle of the cell in row 0, column 0."""
        x, y = (
            middle + (count - 1) * self.resolution / 2
            for middle, count in zip(self.center, self.values.shape, strict=True)
        )
        return x, y

    def height_field(self) -> HeightField:
        """The layer as heights over the x, y plane of its frame."""
        return HeightField(self.values, self.resolution, (*self.corner, 0.0), ((-1.0, 0.0), (0.0, -1.0)))


@dataclass(frozen=True, eq=False, kw_only=True)
class GridPart(Part):
    """The surface through the middles of a map's cells; ``vertices`` are NaN where a cell has no height."""

    map: GridMap
    surface: Organised

    @cached_property
    def drawn(self) -> npt.NDArray[np.int32]:
        """(T, 3) the triangles whose corners have a height; read-only."""
        known = self.surface.valid.reshape(-1)[self.triangles].all(axis=1)
        triangles = self.triangles if known.all() else self.triangles[known]
        triangles.setflags(write=False)
        return triangles


def parse_grid_map(data: bytes, layer: str, max_triangles: int) -> GridMap:
    """Parse the bytes of a grid_map_msgs/GridMap.

    Args:
        data: the serialised message, little or big endian; any bytes are survived.
        layer: name of the layer that is wanted. Values that are not finite are holes.
        max_triangles: largest number of triangles accepted, two between any four cells.

    Raises:
        MeshMessageError: truncated, too large, no such layer, turned, not as grid_map stores it, not plain CDR.
    """
    reader = Reader(data)
    seconds, nanoseconds = reader.numbers("iI", 4, "header.stamp")
    frame = reader.text("header.frame_id")
    resolution, *lengths, x, y, z, qx, qy, qz, qw = reader.numbers("10d", 8, "info")
    names = [reader.text("layers") for _ in range(reader.count("layers"))]
    for _ in range(reader.count("basic_layers")):
        reader.text("basic_layers")
    _check_place(resolution, lengths, (x, y, z), (qx, qy, qz, qw))
    found = _layers(reader, names, layer)
    starts = reader.numbers("HH", 2, "outer_start_index, inner_start_index")
    reader.finish("inner_start_index", GRID_MAP)
    rows, columns, stored = found
    for name, count, length, start in zip("xy", (rows, columns), lengths, starts, strict=True):
        if abs(count * resolution - length) > resolution / 2:
            raise MeshMessageError(
                f"info.length_{name}: expected {count} cells of {resolution:g} m, {count * resolution:g} m, got "
                f"{length:g} m"
            )
        if start >= max(count, 1):
            which = "outer" if name == "x" else "inner"
            raise MeshMessageError(f"{which}_start_index: expected less than {count}, got {start}")
    triangles = 2 * max(rows - 1, 0) * max(columns - 1, 0)
    if triangles > max_triangles or rows * columns > 3 * max_triangles:
        raise MeshMessageError(
            f"bounds.max_triangles: a map of {rows} x {columns} cells has {triangles} triangles and "
            f"{rows * columns} vertices; at most {max_triangles} and three times as many fit"
        )
    values = np.roll(stored.reshape(columns, rows).T.astype(np.float32), [-start for start in starts], (0, 1))
    values[~np.isfinite(values)] = np.nan
    values.setflags(write=False)
    return GridMap(frame, seconds * 1_000_000_000 + nanoseconds, resolution, (x, y), values)


def _check_place(
    resolution: float, lengths: Sequence[float], position: Sequence[float], quaternion: Sequence[float]
) -> None:
    """Refuse what is no place of a map: what grid_map leaves out of an answer is not guessed here."""
    if not _FINEST <= resolution <= _COARSEST:
        raise MeshMessageError(f"info.resolution: expected {_FINEST:g} to {_COARSEST:g} m, got {resolution!r}")
    for name, length in zip("xy", lengths, strict=True):
        if not 0.0 <= length <= LARGEST:
            raise MeshMessageError(f"info.length_{name}: expected 0 to {LARGEST:g} m, got {length!r}")
    for name, value in zip("xy", position, strict=False):
        if not abs(value) <= LARGEST:
            raise MeshMessageError(f"info.pose.position.{name}: expected at most {LARGEST:g} m, got {value!r}")
    if position[2] != 0.0:
        raise MeshMessageError(
            f"info.pose.position.z: expected 0, because grid_map leaves it out and heights are those of the layer, got "
            f"{position[2]!r}"
        )
    if any(quaternion) and not (
        all(abs(value) <= _TURN for value in quaternion[:3]) and abs(abs(quaternion[3]) - 1.0) <= 0.01
    ):
        raise MeshMessageError(
            f"info.pose.orientation: expected no rotation, which grid_map leaves out, got {list(quaternion)}; turn the "
            "frame of the map instead"
        )


def _layers(reader: Reader, names: Sequence[str], wanted: str) -> tuple[int, int, npt.NDArray[Any]]:
    """Rows, columns and the stored numbers, (R * C,), of one layer; all others are stepped over."""
    count = reader.count("data")
    if count != len(names):
        raise MeshMessageError(f"data: expected one for each of {len(names)} layers, got {count}")
    if names.count(wanted) != 1:
        some = ", ".join(repr(name) for name in names[:12]) + (", ..." if len(names) > 12 else "")
        raise MeshMessageError(f"layers: expected one called {wanted!r} (grid_map.layer), got {some or 'none'}")
    found = None
    for number, name in enumerate(names):
        reader.scope = f"data[{number}]."
        dimensions = [
            (reader.text("layout.dim"), *reader.numbers("II", 4, "layout.dim"))
            for _ in range(reader.count("layout.dim"))
        ]
        offset = reader.count("layout.data_offset")
        length = reader.count("data")
        if name != wanted:
            reader.skip(length, 4, 4, "data")
            continue
        labels = tuple(label for label, _, _ in dimensions)
        if labels != _STORED:
            raise MeshMessageError(
                f"{reader.scope}layout.dim: expected labels {list(_STORED)}, which say column by column, got "
                f"{list(labels)}"
            )
        columns, rows = (size for _, size, _ in dimensions)
        if offset or rows * columns != length:
            raise MeshMessageError(
                f"{reader.scope}data: expected {rows} x {columns} numbers from data_offset 0 on, got {length} from "
                f"{offset} on"
            )
        found = rows, columns, reader.array(length, 1, "f4", "data")[:, 0]
    reader.scope = ""
    assert found is not None  # the names hold it once
    return found


def grid_part(grid_map: GridMap, known: Part | None) -> Changes:
    """What a map asks for: the part ``grid_map``, in the frame of its header at its stamp; its removal where the map
    has no cells.

    Args:
        known: the part that there is. Triangles that it has already are taken over.
    """
    if not grid_map.values.size:
        return Changes(remove=(KEY,))
    surface = organised(grid_map.height_field(), None)
    old = known.surface if isinstance(known, GridPart) else None
    same = old is not None and old.grid == surface.grid and np.array_equal(old.valid, surface.valid)
    triangles = known.triangles if same and known is not None else surface.triangles()
    part = GridPart(
        key=KEY,
        vertices=surface.vertices,
        triangles=triangles,
        frame=grid_map.frame,
        stamp=grid_map.stamp,
        locked=False,
        field="header.frame_id of grid_map",
        map=grid_map,
        surface=surface,
    )
    return Changes(put=(part,))


def encode_grid_map(
    grid_map: GridMap, layers: Mapping[str, npt.ArrayLike], basic: Sequence[str] = (), little: bool = True,
    starts: tuple[int, int] = (0, 0),
) -> bytes:  # fmt: skip
    """Bytes of a grid_map_msgs/GridMap, ready for ``publisher.publish(bytes)``.

    Args:
        grid_map: place, size and header.
        layers: name -> (R, C) numbers, row 0 at the largest x, column 0 at the largest y.
        basic: names of the layers that a cell needs to be valid.
        little: byte order of the message.
        starts: row and column at which the ring buffer begins.

    Raises:
        ValueError: a layer has another shape than the map.
    """
    rows, columns = grid_map.values.shape
    writer = Writer(little)
    seconds, nanoseconds = divmod(grid_map.stamp, 1_000_000_000)
    writer.numbers("iI", 4, seconds, nanoseconds)
    writer.text(grid_map.frame)
    resolution = grid_map.resolution
    place = (*grid_map.center, 0.0, 0.0, 0.0, 0.0, 1.0)
    writer.numbers("10d", 8, resolution, rows * resolution, columns * resolution, *place)
    for names in (list(layers), list(basic)):
        writer.numbers("I", 4, len(names))
        for name in names:
            writer.text(name)
    writer.numbers("I", 4, len(layers))
    for name, values in layers.items():
        array = np.asarray(values, np.float32)
        if array.shape != (rows, columns):
            raise ValueError(f"{name}: expected shape {(rows, columns)}, got {array.shape}")
        writer.numbers("I", 4, len(_STORED))
        for label, size, stride in zip(_STORED, (columns, rows), (rows * columns, rows), strict=True):
            writer.text(label)
            writer.numbers("II", 4, size, stride)
        writer.numbers("I", 4, 0)
        writer.array(np.roll(array, starts, (0, 1)).T.reshape(-1, 1), "f4")
    writer.numbers("HH", 2, *starts)
    return writer.message()


def encode_shadow_grid(grid_map: GridMap, dark: npt.NDArray[np.int8], when: int) -> bytes:
    """Bytes of a nav_msgs/OccupancyGrid of the cells of a map.

    Args:
        grid_map: place, size and header.
        dark: (R, C) from 0, lit, to 100, dark; -1 unknown; row 0 at the largest x, column 0 at the largest y.
        when: time of the light [ns], which goes into ``info.map_load_time``.
    """
    rows, columns = dark.shape
    writer = Writer()
    writer.numbers("iI", 4, *divmod(grid_map.stamp, 1_000_000_000))
    writer.text(grid_map.frame)
    writer.numbers("iI", 4, *divmod(when, 1_000_000_000))
    writer.numbers("fII", 4, grid_map.resolution, rows, columns)  # x runs along the width
    x, y = (middle - count * grid_map.resolution / 2 for middle, count in zip(grid_map.center, dark.shape, strict=True))
    writer.numbers("7d", 8, x, y, 0.0, 0.0, 0.0, 0.0, 1.0)
    writer.array(dark[::-1, ::-1].T.reshape(-1, 1), "i1")
    return writer.message()
