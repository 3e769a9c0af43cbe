# SPDX-License-Identifier: Apache-2.0
"""The geometries of a COLLADA file: positions, and triangles of every kind of polygon."""

from __future__ import annotations

from collections import Counter

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import (
    FloatArray,
    IntArray,
    ReadError,
    check_indices,
    fan_triangles,
    strip_triangles,
)
from shadow_tracer.ros.wire.mesh_files.polygons import triangulate, triangulate_rings
from shadow_tracer.ros.wire.mesh_files.xml_text import Element, floats, integers

_KINDS = ("triangles", "polylist", "polygons", "trifans", "tristrips")
_LINES = ("lines", "linestrips")


def read_geometry(geometry: Element, besides: Counter[str]) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (T, 3) of a ``geometry``; ``besides`` counts what has no triangles.

    Raises:
        ReadError: no mesh but another kind of surface, an index out of range, counts that do not fit.
    """
    what = f"geometry {geometry.get('id')!r}"
    mesh = geometry.find("mesh")
    if mesh is None:
        kinds = [child.tag for child in geometry if child.tag not in ("asset", "extra")]
        if kinds == ["spline"]:
            besides["splines"] += 1
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        raise ReadError(f"{what} is {' '.join(map(str, kinds)) or 'empty'}, which is not read; export it as a mesh")
    vertices = _positions(mesh, what)
    triangles = [np.zeros((0, 3), np.int64)]
    for child in mesh:
        if child.tag in _KINDS:
            triangles.append(_primitive(child, vertices, f"{child.tag} of {what}", besides))
        elif child.tag in _LINES:
            besides["lines"] += 1
    return vertices, np.concatenate(triangles)


def _positions(mesh: Element, what: str) -> FloatArray:
    inputs = [item for item in mesh.iterfind("vertices/input") if item.get("semantic") == "POSITION"]
    if len(inputs) != 1:
        raise ReadError(f"{what}: expected one input POSITION of its vertices, got {len(inputs)}")
    wanted = _id(inputs[0].get("source"), what)
    source = next((item for item in mesh.iterfind("source") if item.get("id") == wanted), None)
    accessor = source.find("technique_common/accessor") if source is not None else None
    if source is None or accessor is None:
        raise ReadError(f"{what} has no source {wanted!r} with an accessor")
    wanted = _id(accessor.get("source"), what)
    arrays = [item for item in mesh.iterfind("source/*") if item.get("id") == wanted and item.tag.endswith("_array")]
    if len(arrays) != 1 or arrays[0].tag not in ("float_array", "int_array"):
        raise ReadError(f"{what}: expected one float_array {wanted!r}, got {[item.tag for item in arrays]}")
    numbers = floats(arrays[0].text, f"float_array {wanted!r}")
    if arrays[0].get("count", str(len(numbers))).strip() != str(len(numbers)):
        raise ReadError(f"float_array {wanted!r} says {arrays[0].get('count')} numbers and has {len(numbers)}")
    count, stride, offset = (
        _whole(accessor, name, default, what) for name, default in (("count", None), ("stride", 1), ("offset", 0))
    )
    names = [item.get("name", "") for item in accessor.iterfind("param")]
    columns = [names.index(name) for name in "XYZ"] if set("XYZ") <= set(names) else [0, 1, 2]
    if max(columns) >= stride or count and offset + stride * (count - 1) + max(columns) >= len(numbers):
        raise ReadError(f"{what}: {count} positions with stride {stride} do not fit into {len(numbers)} numbers")
    rows = offset + stride * np.arange(count)[:, None] + np.array(columns)
    return numbers[rows]


def _primitive(item: Element, vertices: FloatArray, what: str, besides: Counter[str]) -> IntArray:
    """Triangles of one of ``_KINDS``."""
    if all(item.find(tag) is None for tag in ("p", "ph")) and _whole(item, "count", 0, what) == 0:
        return np.zeros((0, 3), np.int64)  # some programs write empty ones, without any input
    inputs = [(child.get("semantic"), _whole(child, "offset", 0, what)) for child in item.iterfind("input")]
    offsets = [offset for semantic, offset in inputs if semantic == "VERTEX"]
    if len(offsets) != 1:
        raise ReadError(f"{what}: expected one input VERTEX, got {len(offsets)}")
    width = max(offset for _, offset in inputs) + 1

    def corners(text: str | None) -> IntArray:
        indices = integers(text, what)
        if len(indices) % width:
            raise ReadError(f"{what}: {len(indices)} indices are no multiple of its {width} inputs")
        indices = indices[offsets[0] :: width]
        check_indices(indices, len(vertices), what)
        return indices

    lists = [corners(child.text) for child in item.iterfind("p")]
    flat = np.concatenate([np.zeros(0, np.int64), *lists])
    count = _whole(item, "count", len(lists), what)
    if item.tag == "triangles":
        _fits(len(flat) == 3 * count, what, count, len(flat))
        return flat.reshape(-1, 3)
    if item.tag == "polylist":
        counts = integers(item.findtext("vcount"), what)
        _fits(
            len(counts) == count and int(counts.sum()) == len(flat) and not (counts < 0).any(), what, count, len(flat)
        )
        return _polygons(vertices, flat, counts, besides)
    holes = list(item.iterfind("ph"))
    _fits(len(lists) + len(holes) == count, what, count, len(flat))
    if item.tag != "polygons":
        cut = strip_triangles if item.tag == "tristrips" else fan_triangles
        _fits(not holes and all(len(row) > 2 for row in lists), what, count, len(flat))
        return np.concatenate([np.zeros((0, 3), np.int64), *map(cut, lists)])
    found = [_polygons(vertices, flat, np.array([len(row) for row in lists], np.int64), besides)]
    for hole in holes:
        rings = [corners(ring.text) for ring in (*hole.iterfind("p"), *hole.iterfind("h"))]
        _fits(bool(rings), what, count, len(flat))
        found.append(triangulate_rings(vertices, rings, what))
    return np.concatenate(found)


def _polygons(vertices: FloatArray, corners: IntArray, counts: IntArray, besides: Counter[str]) -> IntArray:
    kept = counts > 2
    besides["polygons with fewer than 3 corners"] += int((~kept).sum())
    return triangulate(vertices, corners[np.repeat(kept, counts)], counts[kept])


def _fits(fits: bool, what: str, count: int, corners: int) -> None:
    if not fits:
        raise ReadError(f"{what}: {corners} corners do not make {count} of them; write the file again")


def _id(reference: str | None, what: str) -> str:
    if not reference or not reference.startswith("#"):
        raise ReadError(f"{what} refers to {reference!r}; only what is in the same file is read")
    return reference[1:]


def _whole(item: Element, name: str, default: int | None, what: str) -> int:
    text = item.get(name)
    if text is None and default is not None:
        return default
    if text is None or not text.strip().isdecimal():
        raise ReadError(f"{what}: expected a whole number for {name}, got {text!r}")
    return int(text)
