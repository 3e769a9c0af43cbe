# SPDX-License-Identifier: Apache-2.0
"""Wavefront OBJ: vertices and faces; texture, normals, groups and materials do not matter here."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import (
    Content,
    FloatArray,
    IntArray,
    ReadError,
    check_indices,
    counted,
    parse_numbers,
)
from shadow_tracer.ros.wire.mesh_files.polygons import triangulate

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
    positions: list[str] = []
    faces = _Faces()
    besides: Counter[str] = Counter()
    for number, words in _statements(text):
        word = words[0]
        if word == "v":
            if len(words) < 4:
                raise ReadError(f"line {number}: expected three coordinates, got {' '.join(words)!r}")
            positions += words[1:4]
        elif word in ("f", "fo"):
            if len(words) > 3:
                faces.add(words, len(positions) // 3, number)
            else:
                besides["faces with fewer than 3 corners"] += 1
        elif word in _SURFACES:
            raise ReadError(f"line {number}: {word!r} is not read; export the mesh as polygons (f)")
        elif word in ("l", "p"):
            besides["lines" if word == "l" else "points"] += 1
        elif word not in _HARMLESS:
            raise ReadError(f"line {number}: {word[:40]!r} is no statement of OBJ; write the file again")
    vertices = _positions(positions)
    corners = faces.indices()
    check_indices(corners, len(vertices))
    return Content(vertices, triangulate(vertices, corners, np.array(faces.counts, np.int64)), counted(besides))


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Words of each statement without its comment, and the line at which it begins."""
    begin, pending = 0, ""
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        if "#" in line:
            line = line.partition("#")[0]
        if "\\" in line and line.rstrip().endswith("\\"):
            begin, pending = begin or number, pending + line.rstrip()[:-1] + " "
            continue
        if pending:
            line = pending + line
        words = line.split()
        if words:
            yield begin or number, words
        begin, pending = 0, ""
    if pending.split():
        raise ReadError(f"line {begin}: the file ends within a statement")


class _Faces:
    """Corners as they are written, such as ``7/1/2`` or ``-1//3``, until all faces are known."""

    def __init__(self) -> None:
        self.counts: list[int] = []
        self._corners: list[str] = []
        self._above: list[int] = []  # vertices above each face, from which relative indices count back
        self._lines: list[int] = []

    def add(self, words: list[str], above: int, line: int) -> None:
        self._corners += words[1:]
        self.counts.append(len(words) - 1)
        self._above.append(above)
        self._lines.append(line)

    def indices(self) -> IntArray:
        """Indices from 0 of the corners of all faces."""
        corners = self._corners
        if any("/" in corner for corner in corners):
            corners = [corner.partition("/")[0] for corner in corners]
        try:
            written = parse_numbers(corners, np.int64)
        except (ValueError, OverflowError):
            k = next(k for k, corner in enumerate(corners) if not re.fullmatch(r"[-+]?\d{1,18}", corner))
            raise ReadError(f"line {self._line(k)}: expected the index of a vertex, got {self._corners[k]!r}") from None
        above = np.repeat(np.array(self._above, np.int64), self.counts)
        wrong = np.flatnonzero((written == 0) | (written < -above))
        if len(wrong):
            k = int(wrong[0])
            raise ReadError(
                f"line {self._line(k)}: index {written[k]} leads to no vertex; {above[k]} stand above it, counted "
                "from 1"
            )
        return np.where(written > 0, written - 1, above + written)

    def _line(self, corner: int) -> int:
        return self._lines[int(np.searchsorted(np.cumsum(self.counts), corner, side="right"))]


def _positions(words: list[str]) -> FloatArray:
    try:
        return parse_numbers(words, np.float64).reshape(-1, 3)
    except ValueError:
        for k, word in enumerate(words):
            try:
                float(word)
            except ValueError:
                row = words[k - k % 3 : k - k % 3 + 3]
                raise ReadError(f"vertex {k // 3 + 1} (counted from 1): expected three numbers, got {row}") from None
        raise
