# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/PointCloud2 <-> numpy: points to be queried, and clouds of which every three points are a triangle.

Messages are taken as objects with the fields of PointCloud2, whoever made them; no ROS is imported. Whatever is wrong
with one is a :class:`PartError` that names the field, and nothing is allocated before it is known to be there.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.messages import stamp_ns
from shadow_tracer.ros.wire.parts import Changes, Part, PartError, soup_triangles
from shadow_tracer.scene.checks import LARGEST

CLOUD = "cloud"

# Datatypes of sensor_msgs/PointField.
_UINT8, _UINT32, _FLOAT32, _FLOAT64 = 2, 6, 7, 8
_REAL = {_FLOAT32: "f4", _FLOAT64: "f8"}
_NORMAL = ("normal_x", "normal_y", "normal_z")  # as the Point Cloud Library writes them

_CONES = ("radius", "half_angle")  # of cones to lights

# x, y, z, lights, known of an answer: name, offset, datatype, format. Padded so that all rows of points stay aligned.
_ANSWER = (
    ("x", 0, _FLOAT32, "<f4"),
    ("y", 4, _FLOAT32, "<f4"),
    ("z", 8, _FLOAT32, "<f4"),
    ("lights", 12, _UINT32, "<u4"),
    ("known", 16, _UINT8, "u1"),
)
# And what is certain of cones.
_CERTAIN = (("free", 20, _UINT32, "<u4"), ("blocked", 24, _UINT32, "<u4"))
_ANSWER_STEP, _CERTAIN_STEP = 20, 28


@dataclass(frozen=True)
class _Layout:
    """Where the coordinates of a cloud are; checked, all bytes of it are there."""

    height: int
    width: int
    point_step: int
    row_step: int
    columns: tuple[tuple[int, np.dtype[Any]], ...]  # offset and format of x, y, z, or of other fields

    @property
    def count(self) -> int:
        return self.height * self.width


def _column(fields: Any, name: str, wanted: Sequence[str], point_step: int, order: str) -> tuple[int, np.dtype[Any]]:
    found = [field for field in fields if field.name == name]
    if len(found) != 1:
        names = [str(field.name) for field in fields[:16]]
        what = f"one each of {', '.join(wanted[:-1])} and {wanted[-1]}" if wanted[1:] else f"one {wanted[0]}"
        raise PartError(f"fields: expected {what}, got {names}{' ...' if len(fields) > 16 else ''}")
    offset, datatype, count = int(found[0].offset), int(found[0].datatype), int(found[0].count)
    kind = _REAL.get(datatype)
    if kind is None:
        raise PartError(f"fields: expected {name} of datatype 7 (FLOAT32) or 8 (FLOAT64), got {datatype}")
    if count > 1:  # some drivers leave it 0
        raise PartError(f"fields: expected {name} with count 1, got {count}")
    dtype = np.dtype(order + kind)
    if offset + dtype.itemsize > point_step:
        raise PartError(
            f"fields: {name} ends at byte {offset + dtype.itemsize} of a point, but point_step is {point_step}"
        )
    return offset, dtype


def _layout(msg: Any, wanted: Sequence[str] = "xyz") -> _Layout:
    height, width = int(msg.height), int(msg.width)
    point_step, row_step, size = int(msg.point_step), int(msg.row_step), len(msg.data)
    if height * width == 0:
        if size:
            raise PartError(f"width, height: {width} x {height} points, but data has {size} bytes")
        return _Layout(0, 0, 0, 0, ())
    order = ">" if msg.is_bigendian else "<"
    columns = tuple(_column(msg.fields, name, wanted, point_step, order) for name in wanted)
    if height > 1 and row_step < width * point_step:
        raise PartError(f"row_step: expected at least width * point_step = {width * point_step} bytes, got {row_step}")
    needed = (height - 1) * row_step + width * point_step  # a single row has no need of row_step
    if size < needed:
        raise PartError(f"data: {width} x {height} points need {needed} bytes, got {size}")
    return _Layout(height, width, point_step, row_step, columns)


def _points(msg: Any, layout: _Layout, columns: int = 3) -> FloatArray:
    points = np.empty((layout.count, columns))
    if layout.count:
        grid = points.reshape(layout.height, layout.width, columns)
        strides = (layout.row_step, layout.point_step)
        with np.errstate(invalid="ignore"):  # a signalling NaN is one, too
            for k, (offset, dtype) in enumerate(layout.columns):
                grid[..., k] = np.ndarray(grid.shape[:2], dtype, msg.data, offset, strides)
    return points


def cloud_points(msg: Any) -> FloatArray:
    """Points of a cloud, row by row.

    Args:
        msg: a sensor_msgs/PointCloud2 with fields x, y, z, each FLOAT32 or FLOAT64 at any offset; either byte order;
            ``point_step`` and, where there is more than one row, ``row_step`` are honoured. No width or no height and
            no data is a cloud without points, whatever its fields.

    Returns:
        (height * width, 3) float64 [m] in the frame of the header. NaN and infinity stay what they are.

    Raises:
        PartError: a field is missing or of another type, a step is too small, data too short.
    """
    return _points(msg, _layout(msg))


def cloud_normals(msg: Any) -> FloatArray | None:
    """Unit normals of the points of a cloud, row by row.

    Args:
        msg: as for :func:`cloud_points`; with fields normal_x, normal_y, normal_z, of the same types as x, y, z.

    Returns:
        (height * width, 3) float64 in the frame of the header, zeros where a normal is zero or not finite. None: the
        cloud has none of these fields.

    Raises:
        PartError: as for :func:`cloud_points`, or it has some of these fields and not all.
    """
    if not any(field.name in _NORMAL for field in msg.fields):
        return None
    normals = _points(msg, _layout(msg, _NORMAL))
    largest = np.abs(normals).max(axis=1, initial=0.0)  # NaN stays NaN
    good = np.isfinite(largest) & (largest > 0.0)
    normals[~good] = 0.0
    normals[good] /= largest[good, None]  # so that no square leaves float64
    squares = normals * normals
    length = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
    normals[good] /= length[good, None]
    return normals


def cloud_cones(msg: Any, most: Mapping[str, float]) -> tuple[str, FloatArray] | None:
    """How wide the cones are that the points of a cloud are apices of, row by row.

    Args:
        msg: as for :func:`cloud_points`; with a field radius or half_angle, of the same types as x, y, z.
        most: the largest value of each.

    Returns:
        "radius" [m] or "half_angle" [rad], and (height * width,) float64; NaN and infinity stay what they are. None:
        the cloud has neither field.

    Raises:
        PartError: as for :func:`cloud_points`, it has both fields, or a number that is negative or too large.
    """
    names = sorted({field.name for field in msg.fields if field.name in _CONES})
    if not names:
        return None
    if len(names) == 2:
        raise PartError("fields: expected radius or half_angle, got both")
    name = str(names[0])
    sizes = _points(msg, _layout(msg, names), 1)[:, 0]
    wrong = np.flatnonzero(np.isfinite(sizes) & ~((sizes >= 0.0) & (sizes <= most[name])))
    if len(wrong):
        raise PartError(f"data: expected {name} from 0 to {most[name]:g}, got {sizes[wrong[0]]:g} for point {wrong[0]}")
    return name, sizes


def soup_part(msg: Any, parts: Mapping[str, Part], max_triangles: int) -> Changes:
    """What a cloud asks for of which points 0 1 2, 3 4 5 and so on are the corners of triangles.

    Args:
        msg: as for :func:`cloud_points`.
        parts: the parts there are. Points that the part "cloud" already has are taken over from it, uncopied.
        max_triangles: largest number of triangles accepted.

    Returns:
        The part "cloud", at the stamp of the header in its frame; its removal where the cloud has no points.

    Raises:
        PartError: as for :func:`cloud_points`, points that are no multiple of three, not finite or beyond 1e50, too
            many triangles.
    """
    layout = _layout(msg)
    count = layout.count
    if count == 0:
        return Changes(remove=(CLOUD,))
    if count % 3:
        raise PartError(
            f"width, height: expected a multiple of 3 points, every three a triangle, got {layout.width} x "
            f"{layout.height} = {count}"
        )
    if count // 3 > max_triangles:
        raise PartError(f"bounds.max_triangles: the cloud has {count // 3} triangles, the bound is {max_triangles}")
    points = _points(msg, layout)
    low, high = float(points.min()), float(points.max())  # NaN comes out of both
    if not (low >= -LARGEST and high <= LARGEST):
        bad = int(np.flatnonzero(~(np.abs(points.ravel()) <= LARGEST))[0])
        raise PartError(
            f"data: expected finite coordinates of at most {LARGEST:g} m, got {points.flat[bad]} for "
            f"{'xyz'[bad % 3]} of point {bad // 3}"
        )
    known = parts.get(CLOUD)
    # Other points mostly differ from the first on; that is told without reading all of them.
    if known is not None and all(np.array_equal(known.vertices[:n], points[:n]) for n in (64, count)):
        points = known.vertices
    points.setflags(write=False)
    part = Part(
        key=CLOUD,
        vertices=points,
        triangles=soup_triangles(count // 3),
        frame=str(msg.header.frame_id),
        stamp=stamp_ns(msg.header.stamp),
        locked=False,
        field="header.frame_id of mesh_cloud",
    )
    return Changes(put=(part,))


def visibility_cloud(
    msg: Any,
    points: FloatArray,
    bits: npt.ArrayLike,
    known: npt.ArrayLike,
    certain: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
) -> Any:
    """The answer to a query: its points with what reaches them.

    Args:
        msg: the query, a PointCloud2; header, height and width are taken from it. Nothing of it is changed.
        points: (N, 3) its points, as :func:`cloud_points` gives them.
        bits: (N,) unsigned integers below 2^32; bit i tells that light i reaches the point.
        known: (N,) bool, False where nothing is known of the point.
        certain: of a query about cones two more of such (N,): bit i tells that the cone to light i is certainly free,
            and that it is certainly blocked.

    Returns:
        A message of the class of ``msg``, little endian, of 20 bytes a point: x, y, z FLOAT32, lights UINT32, known
        UINT8 (1 or 0); of 28 with free UINT32 and blocked UINT32 if ``certain`` is there.

    Raises:
        ValueError: the arrays do not have one row for each point of ``msg``, or a bit above 31 is set.
    """
    height, width = int(msg.height), int(msg.width)
    count = height * width
    known = np.asarray(known, dtype=np.bool_)
    for name, array_, shape in (("points", points, (count, 3)), ("known", known, (count,))):
        if array_.shape != shape:
            raise ValueError(f"{name}: expected shape {shape}, got {array_.shape}")
    columns = {"lights": _bit_field("bits", bits, count)}
    if certain is not None:
        free, blocked = (_bit_field("certain", values, count) for values in certain)
        columns |= {"free": free, "blocked": blocked}
    answer, step = (_ANSWER, _ANSWER_STEP) if certain is None else ((*_ANSWER, *_CERTAIN), _CERTAIN_STEP)
    names, offsets, _, formats = zip(*answer, strict=True)
    layout: Any = {"names": names, "offsets": offsets, "formats": formats, "itemsize": step}
    rows: Any = np.zeros(count, np.dtype(layout))
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinity
        for k, name in enumerate("xyz"):
            rows[name] = points[:, k]
    for name, column in columns.items():
        rows[name] = column
    rows["known"] = known
    make = _point_field(msg)
    return type(msg)(
        header=msg.header,
        height=height,
        width=width,
        fields=[make(name=name, offset=offset, datatype=kind, count=1) for name, offset, kind, _ in answer],
        is_bigendian=False,
        point_step=step,
        row_step=step * width if count else 0,
        data=_bytes_like(msg.data, rows),
        is_dense=bool(np.isfinite(points).all()),
    )


def _bit_field(name: str, values: npt.ArrayLike, count: int) -> npt.NDArray[Any]:
    """Bits of so many points."""
    bits = np.asarray(values)
    if bits.shape != (count,):
        raise ValueError(f"{name}: expected shape {(count,)}, got {bits.shape}")
    if count and (bits.dtype.kind not in "iu" or int(bits.min()) < 0 or int(bits.max()) >= 2**32):
        raise ValueError(f"{name}: expected integers from 0 to 2^32 - 1, got dtype {bits.dtype} up to {bits.max()}")
    return bits


def _point_field(msg: Any) -> Any:
    """The class PointField that goes with the class of a cloud."""
    if len(msg.fields):
        return type(msg.fields[0])
    from sensor_msgs.msg import PointField

    return PointField


def _bytes_like(data: Any, rows: npt.NDArray[Any]) -> Any:
    """The bytes of ``rows`` in the container that messages of this kind have for them: array.array, else numpy."""
    if isinstance(data, np.ndarray):
        return rows.view(np.uint8)
    return array("B", rows.tobytes())
