# SPDX-License-Identifier: Apache-2.0
"""Wavefront OBJ: vertices and faces; texture, normals, groups and materials do not matter here."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from shadow_tracer.ros.mesh_files.content import Content, FloatArray, ReadError, check_indices, counted
from shadow_tracer.ros.mesh_files.polygons import triangulate

# Statements that describe a surface in another way, or bring in what stands elsewhere.
_SURFACES = frozenset({"bsp", "bzp", "call", "cdc", "cdp", "csh", "curv", "res", "surf"})
_HARMLESS = frozenset(
    "bevel bmat c_interp con cstype ctech curv2 d_interp deg end g hole lod maplib mg mtllib o parm s scrv shadow_obj "
    "sp stech step trace_obj trim usemap usemtl vn vp vt".split()
)


def read_obj(path: Path) -> Content:
    """Every ``f`` of a file. Lines and points are named as left out.

    Raises:
        ReadError: a statement is not known or cannot be read, an index is 0 or leads to no vertex, surfaces that are
            no polygons.
    """
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    positions: list[list[str]] = []
    corners: list[int] = []
    counts: list[int] = []
    besides: Counter[str] = Counter()
    for number, words in _statements(text):
        word = words[0]
        if word == "v":
            if len(words) < 4:
                raise ReadError(f"line {number}: expected three coordinates, got {' '.join(words)!r}")
            positions.append(words[1:4])
        elif word in ("f", "fo"):
            face = [_index(corner, len(positions), number) for corner in words[1:]]
            if len(face) > 2:
                corners += face
                counts.append(len(face))
            else:
                besides["faces with fewer than 3 corners"] += 1
        elif word in _SURFACES:
            raise ReadError(f"line {number}: {word!r} is not read; export the mesh as polygons (f)")
        elif word in ("l", "p"):
            besides["lines" if word == "l" else "points"] += 1
        elif word not in _HARMLESS:
            raise ReadError(f"line {number}: {word[:40]!r} is no statement of OBJ; write the file again")
    vertices = _positions(positions)
    flat = np.array(corners, np.int64)
    check_indices(flat, len(vertices))
    triangles = triangulate(vertices, flat, np.array(counts, np.int64))
    return Content(vertices, triangles, counted(besides))


def _statements(text: str) -> list[tuple[int, list[str]]]:
    """Words of each statement without its comment, and the line at which it begins."""
    found, begin, pending = [], 0, ""
    for number, line in enumerate(re.split("\r\n|\n|\r", text), 1):
        line = line.partition("#")[0].rstrip()
        begin = begin or number
        if line.endswith("\\"):
            pending += line[:-1] + " "
            continue
        words = (pending + line).split()
        if words:
            found.append((begin, words))
        begin, pending = 0, ""
    if pending.split():
        raise ReadError(f"line {begin}: the file ends within a statement")
    return found


def _index(corner: str, so_far: int, line: int) -> int:
    """Index from 0 of a corner such as ``7/1/2`` or ``-1//3``; relative ones count back from the last vertex above."""
    try:
        index = int(corner.partition("/")[0])
    except ValueError:
        raise ReadError(f"line {line}: expected the index of a vertex, got {corner!r}") from None
    if index == 0 or index < -so_far:
        raise ReadError(f"line {line}: index {index} leads to no vertex; {so_far} stand above it, counted from 1")
    return index - 1 if index > 0 else so_far + index


def _positions(words: list[list[str]]) -> FloatArray:
    try:
        return np.array(words, np.float64).reshape(-1, 3)
    except ValueError:
        for number, row in enumerate(words, 1):
            try:
                [float(word) for word in row]
            except ValueError:
                raise ReadError(f"vertex {number} (counted from 1): expected three numbers, got {row}") from None
        raise
