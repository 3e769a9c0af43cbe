# SPDX-License-Identifier: Apache-2.0
"""OFF as text, with colours and normals beside the positions (COFF, NOFF, STOFF)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import Content, ReadError, check_indices, counted, parse_numbers
from shadow_tracer.ros.wire.mesh_files.polygons import triangulate

_KEYWORD = re.compile(r"\s*(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z])")


def read_off(path: Path) -> Content:
    """All faces. Raises ReadError: binary, other dimensions than three, a line too many or too few, no numbers."""
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    text = re.sub(r"#[^\r\n]*", "", text)
    keyword = _KEYWORD.match(text)
    if keyword is None:
        raise ReadError("it does not begin with OFF")
    if keyword[4] or keyword[5] or text[keyword.end() :].split()[:1] == ["BINARY"]:
        raise ReadError(
            "OFF of other dimensions than 3, or binary, is not read; write it as text with three coordinates"
        )
    lines = [line.split() for line in re.split("[\r\n]+", text[keyword.end() :]) if line.strip()]
    try:
        vertex_count, face_count = (int(word) for word in lines[0][:2])
    except (IndexError, ValueError):
        raise ReadError("expected the counts of vertices, faces and edges after OFF") from None
    rows = lines[1:]
    if min(vertex_count, face_count) < 0 or len(rows) != vertex_count + face_count:
        raise ReadError(
            f"{vertex_count} vertices and {face_count} faces need a line each, but {len(rows)} lines follow; "
            "write the file again"
        )
    if any(len(row) < 3 for row in rows[:vertex_count]):
        raise ReadError("a vertex has fewer than three coordinates")
    try:
        positions = [word for row in rows[:vertex_count] for word in row[:3]]
        vertices = parse_numbers(positions, np.float64).reshape(-1, 3)
        faces = [[int(word) for word in row[1 : 1 + int(row[0])]] for row in rows[vertex_count:]]
        wrong = next((k for k, face in enumerate(faces) if len(face) != int(rows[vertex_count + k][0])), None)
    except ValueError as error:
        raise ReadError(f"a line does not hold the numbers that it should: {error}") from error
    if wrong is not None:
        raise ReadError(f"face {wrong} (counted from 0) has fewer corners than it says")
    whole = [face for face in faces if len(face) > 2]
    corners = np.array([corner for face in whole for corner in face], np.int64)
    check_indices(corners, vertex_count)
    triangles = triangulate(vertices, corners, np.array([len(face) for face in whole], np.int64))
    return Content(vertices, triangles, counted({"faces with fewer than 3 corners": len(faces) - len(whole)}))
