# SPDX-License-Identifier: Apache-2.0
"""Figures of meshes that are read from files, to compare with what the files hold."""

from __future__ import annotations

import json
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.mesh_files import load_mesh_file

SQUARE = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0))
TWO = ((0, 1, 2), (2, 1, 3))

Mesh = tuple[np.ndarray, np.ndarray]


def read(path: Path, scale: float = 0.0) -> tuple[Mesh, str]:
    """A mesh, and what the loader says that it has left out."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mesh = load_mesh_file(str(path), scale)
    return mesh, " ".join(str(warning.message).partition("shadow: ")[2] for warning in caught)


def area(mesh: Mesh) -> float:
    a, b, c = (mesh[0][mesh[1][:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def check(mesh: Mesh, triangles: int, low: Any, high: Any, wanted_area: float) -> None:
    """Count of triangles, bounding box and area to four digits and more."""
    corners = mesh[0][mesh[1]].reshape(-1, 3)
    size = np.ptp(corners, axis=0).max()
    assert len(mesh[1]) == triangles
    np.testing.assert_allclose(corners.min(axis=0), low, rtol=0, atol=5e-4 * size)
    np.testing.assert_allclose(corners.max(axis=0), high, rtol=0, atol=5e-4 * size)
    assert abs(area(mesh) - wanted_area) <= 1e-5 * wanted_area


def blocked(mesh: Mesh, start: Any, end: Any) -> bool:
    """Whether a triangle meets the segment, in plain float64; the ends are far from every edge."""
    start, way = np.array(start, float), np.subtract(end, start).astype(float)
    for a, b, c in mesh[0][mesh[1]]:
        solution = np.linalg.lstsq(np.stack([b - a, c - a, -way], axis=1), start - a, rcond=None)
        u, v, t = solution[0]
        if solution[2] == 3 and u >= 0.0 and v >= 0.0 and u + v <= 1.0 and 0.0 <= t <= 1.0:
            return True
    return False


class Gltf:
    """A glTF file in the making: arrays become accessors, the rest is plain JSON."""

    def __init__(self) -> None:
        self.root: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
        self.root |= {"nodes": [{"mesh": 0}], "meshes": [], "accessors": [], "bufferViews": []}
        self.blob = b""

    def view(self, data: bytes, **more: Any) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.root["bufferViews"].append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more})
        self.blob += data
        return len(self.root["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str, view: int | None = None, **more: Any) -> int:
        array = np.asarray(values, dtype)
        component = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}[dtype.lstrip("<")]
        kind = {0: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[array.shape[1] if array.ndim > 1 else 0]
        item = {"componentType": component, "count": len(array), "type": kind, **more}
        item["bufferView"] = self.view(array.tobytes()) if view is None else view
        self.root["accessors"].append(item)
        return len(self.root["accessors"]) - 1

    def mesh(self, *primitives: dict[str, Any], **more: Any) -> int:
        self.root["meshes"].append({"primitives": list(primitives), **more})
        return len(self.root["meshes"]) - 1

    def square(self, z: float = 0.0, **more: Any) -> dict[str, Any]:
        position = self.accessor(np.array(SQUARE) + (0.0, 0.0, z), "<f4")
        return {"attributes": {"POSITION": position}, "indices": self.accessor(np.ravel(TWO), "<u2"), **more}

    def require(self, *names: str) -> None:
        self.root["extensionsUsed"] = self.root["extensionsRequired"] = list(names)

    def write(self, path: Path) -> Path:
        path.write_bytes(self.bytes())
        return path

    def bytes(self) -> bytes:
        self.root["buffers"] = [{"byteLength": len(self.blob)}]
        text = json.dumps(self.root).encode()
        text += b" " * (-len(text) % 4)
        blob = self.blob + b"\0" * (-len(self.blob) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
        return head + chunks
