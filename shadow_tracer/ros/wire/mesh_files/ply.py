# SPDX-License-Identifier: Apache-2.0
"""PLY, text and binary of either byte order: faces and triangle strips, whatever else stands in the file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import (
    Content,
    FloatArray,
    IntArray,
    ReadError,
    check_indices,
    counted,
    strip_triangles,
)
from shadow_tracer.ros.wire.mesh_files.ply_body import BinaryBody, Column, Columns, TextBody
from shadow_tracer.ros.wire.mesh_files.polygons import triangulate

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("int64", "longlong"), "i8"),
    **dict.fromkeys(("uint64", "ulonglong"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST = 4096  # bytes of a line of the header
_INDICES = ("vertex_indices", "vertex_index", "vertex_ids")


@dataclass
class _Element:
    name: str
    count: int
    columns: list[Column] = field(default_factory=list)


def read_ply(path: Path) -> Content:
    """Elements ``face`` and ``tristrips``; edges and elements with lists that are not known are named as left out.

    Raises:
        ReadError: the header is not understood, the body is cut short or longer than the header says, an index leads
            to no vertex.
    """
    data = path.read_bytes()
    order, elements, start = _header(data)
    body = BinaryBody(data, start, _ORDERS[order]) if order != "ascii" else TextBody(data[start:])
    tables = {}
    for element in elements:
        if element.name in tables:
            raise ReadError(f"it has two elements {element.name!r}")
        tables[element.name] = body.take(element.name, element.count, element.columns)
    if body.left:
        raise ReadError(f"{body.left} are left over behind what the header names; write the file again")
    if "vertex" not in tables:
        raise ReadError("it has no element 'vertex'")
    vertices = _vertices(tables["vertex"])
    faces, short = _faces(vertices, tables.get("face"))
    strips = _strips(len(vertices), tables.get("tristrips"))
    besides = {"faces with fewer than 3 corners": short}
    for element in elements:
        has_lists = any(column.counts for column in element.columns)
        if element.name not in ("vertex", "face", "tristrips") and (has_lists or element.name == "edge"):
            besides[f"rows of {element.name!r}"] = element.count
    return Content(vertices, np.concatenate([faces, strips]), counted(besides))


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Format, elements, and where the body begins."""
    end = b"\r\n" if data[3:5] == b"\r\n" else data[3:4]
    if data[:3] != b"ply" or end not in (b"\n", b"\r", b"\r\n"):
        raise ReadError("it does not begin with a line 'ply'")
    order, elements, start = "", [], len(b"ply" + end)
    while True:
        line, found, _ = data[start : start + _LONGEST].partition(end)
        if not found:
            raise ReadError("its header has no end")
        start += len(line) + len(end)
        words = line.decode("latin-1").split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words == ["end_header"]:
            break
        if words[0] == "format" and len(words) > 1 and words[1] in _ORDERS:
            order = words[1]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            elements.append(_Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and (column := _column(words[1:])):
            elements[-1].columns.append(column)
        else:
            raise ReadError(f"its header is not understood: {' '.join(words)[:80]!r}")
    if not order:
        raise ReadError(f"its header names no format; expected one of {sorted(_ORDERS)}")
    return order, elements, start


def _column(words: list[str]) -> Column | None:
    if len(words) == 2 and words[0] in _TYPES:
        return Column(words[1], _TYPES[words[0]])
    if len(words) == 4 and words[0] == "list" and words[1] in _TYPES and words[2] in _TYPES:
        return Column(words[3], _TYPES[words[2]], _TYPES[words[1]])
    return None


def _vertices(table: Columns) -> FloatArray:
    missing = [name for name in "xyz" if name not in table.values]
    if missing:
        raise ReadError(f"its vertices have no {missing[0]}")
    return np.stack([np.asarray(table.values[name], np.float64) for name in "xyz"], axis=1)


def _indices(table: Columns, what: str) -> tuple[IntArray, IntArray]:
    """All indices of the rows of a table, and how many each row has."""
    lists: list[Any] = [table.lists[name] for name in _INDICES if name in table.lists]
    if len(lists) != 1:
        raise ReadError(f"expected one list of {what}, {' or '.join(_INDICES)}; got {sorted(table.lists)}")
    values, counts = lists[0]
    if values.dtype.kind not in "iu":
        raise ReadError(f"the indices of {what} are no integers")
    return values.astype(np.int64), counts


def _faces(vertices: FloatArray, table: Columns | None) -> tuple[IntArray, int]:
    """Triangles of the faces, and how many faces have fewer than three corners."""
    if table is None or not table.count:
        return np.zeros((0, 3), np.int64), 0
    corners, counts = _indices(table, "face")
    check_indices(corners, len(vertices))
    kept = counts > 2
    corners = corners[np.repeat(kept, counts)]
    return triangulate(vertices, corners, counts[kept]), int((~kept).sum())


def _strips(vertex_count: int, table: Columns | None) -> IntArray:
    triangles = [np.zeros((0, 3), np.int64)]
    if table is not None and table.count:
        corners, counts = _indices(table, "tristrips")
        check_indices(corners[corners != -1], vertex_count)
        for row in np.split(corners, np.cumsum(counts)[:-1]):
            for strip in np.split(row, np.flatnonzero(row == -1)):  # each but the first begins with its -1
                triangles.append(strip_triangles(strip[strip != -1]))
    return np.concatenate(triangles)
