# SPDX-License-Identifier: Apache-2.0
"""STL, binary and text. The size of a binary file must be the one that its count asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import Content, ReadError

_HEAD, _TRIANGLE = 84, 50  # bytes
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_FACET = (b"facet", b"outer", b"vertex", b"vertex", b"vertex", b"endloop", b"endfacet")
_CURE = "write the file again"


def read_stl(path: Path) -> Content:
    """All facets of all solids. Raises ReadError if the file is cut short, or holds more than it says."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little") if len(data) >= _HEAD else -1
    if data.lstrip()[:5].lower() == b"solid" and b"\0" not in data[: 2 * _HEAD]:
        return _text(data)  # binary files may begin with that word too, but they have zero bytes
    if count < 0:
        raise ReadError(f"it is neither text that begins with 'solid' nor binary: it has {len(data)} bytes; {_CURE}")
    whole, left = divmod(len(data) - _HEAD, _TRIANGLE)
    if whole < count:
        raise ReadError(f"it is cut short: it should have {count} triangles and has {whole}; {_CURE}")
    if whole > count:
        raise ReadError(f"it says that it has {count} triangles, but {whole} fit into its bytes; {_CURE}")
    corners = np.frombuffer(data, _RECORD, count, _HEAD)["corners"]
    return _soup(corners.astype(np.float64), (f"{left} bytes at the end",) if left else ())


def _soup(corners: np.ndarray, left_out: tuple[str, ...] = ()) -> Content:
    vertices = corners.reshape(-1, 3)
    return Content(vertices, np.arange(len(vertices)).reshape(-1, 3), left_out)


def _text(data: bytes) -> Content:
    corners: list[list[bytes]] = []
    step: int | None = None  # place in _FACET; None is outside of a solid
    last = 0
    for number, line in enumerate(data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n"), 1):
        words = line.split()
        if not words:
            continue
        last, word = number, words[0].lower()
        if (word, step) == (b"solid", None):
            step = 0
        elif (word, step) == (b"endsolid", 0):
            step = None
        elif step is not None and word == _FACET[step] and (word != b"vertex" or len(words) == 4):
            step = (step + 1) % len(_FACET)
            if word == b"vertex":
                corners.append(words[1:])
        else:
            shown = line[:60].decode(errors="replace")
            raise ReadError(f"line {number} does not belong into a text STL at that place: {shown!r}; {_CURE}")
    if step is not None:
        missing = _FACET[step] if step else b"endsolid"
        raise ReadError(f"it is cut short: {missing.decode()!r} is missing after line {last}; {_CURE}")
    try:
        return _soup(np.array(corners, np.float64).reshape(-1, 3, 3))
    except ValueError as error:
        raise ReadError(f"a coordinate is no number: {error}") from error
