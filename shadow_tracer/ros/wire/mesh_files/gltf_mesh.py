# SPDX-License-Identifier: Apache-2.0
"""Meshes of a glTF file: triangles of every mode, morph targets, joints, Draco."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import (
    FloatArray,
    IntArray,
    ReadError,
    check_indices,
    fan_triangles,
    strip_triangles,
)
from shadow_tracer.ros.wire.mesh_files.gltf_data import GltfData

DRACO = "KHR_draco_mesh_compression"
PLAIN = "write it without compression (`npx @gltf-transform/cli copy in.glb out.glb`)"

_LINES = {0: "points", 1: "lines", 2: "lines", 3: "lines"}


@dataclass(frozen=True, eq=False)
class Primitive:
    """Triangles with one kind of attributes.

    Attributes:
        vertices: (V, 3) float64.
        triangles: (T, 3) int64, in range.
        joints: (V, J) numbers of joints of the skin, None if there are none.
        weights: (V, J) their shares, which add up to 1.
    """

    vertices: FloatArray
    triangles: IntArray
    joints: IntArray | None = None
    weights: FloatArray | None = None


def read_mesh(data: GltfData, number: int, weights: Sequence[float] | None, besides: Counter[str]) -> list[Primitive]:
    """Primitives of mesh ``number``.

    Args:
        weights: of the morph targets, None takes those of the mesh.
        besides: counts points and lines, which have no triangles.
    """
    mesh = data.item("meshes", number)
    weights = mesh.get("weights") if weights is None else weights
    found = []
    for k, primitive in enumerate(mesh.get("primitives", [])):
        what = f"meshes[{number}].primitives[{k}]"
        mode = primitive.get("mode", 4)
        if mode in _LINES:
            besides[_LINES[mode]] += 1
        elif mode in (4, 5, 6):
            found.append(_read(data, primitive, mode, weights, what))
        else:
            raise ReadError(f"{what}.mode: expected 0 to 6, got {mode!r}")
    return found


def _read(
    data: GltfData, primitive: dict[str, Any], mode: int, weights: Sequence[float] | None, what: str
) -> Primitive:
    attributes = primitive.get("attributes", {})
    if "POSITION" not in attributes:
        raise ReadError(f"{what} has no POSITION")
    extension = primitive.get("extensions", {}).get(DRACO)
    if extension is not None and not data.has_data(attributes["POSITION"]):
        vertices, triangles = _draco(data, extension, attributes["POSITION"], what)
        if "JOINTS_0" in attributes:
            raise ReadError(f"{what}: a skin within Draco is not read; {PLAIN}")
    else:
        vertices = data.values(attributes["POSITION"], "VEC3").astype(np.float64)
        triangles = _triangles(_corners(data, primitive, len(vertices), what), mode, what)
    vertices = _morphed(data, vertices, primitive.get("targets", []), weights, what)
    return Primitive(vertices, triangles, *_joints(data, attributes, len(vertices), what))


def _corners(data: GltfData, primitive: dict[str, Any], count: int, what: str) -> IntArray:
    if "indices" not in primitive:
        return np.arange(count)
    if not data.has_data(primitive["indices"]):
        raise ReadError(f"{what}.indices has no data")
    indices = data.values(primitive["indices"], "SCALAR")[:, 0]
    if indices.dtype.kind != "u":
        raise ReadError(f"{what}.indices: expected unsigned integers")
    if indices.size and indices.max() == np.iinfo(indices.dtype).max:
        raise ReadError(f"{what} uses index {indices.max()} to begin a strip again, which glTF forbids")
    check_indices(indices, count, what)
    return indices.astype(np.int64)


def _triangles(corners: IntArray, mode: int, what: str) -> IntArray:
    if mode == 4:
        if len(corners) % 3:
            raise ReadError(f"{what} has {len(corners)} corners, which make no whole triangles")
        return corners.reshape(-1, 3)
    if len(corners) < 3:
        raise ReadError(f"{what} has {len(corners)} corners, too few for a triangle")
    return strip_triangles(corners) if mode == 5 else fan_triangles(corners)


def _morphed(
    data: GltfData, vertices: FloatArray, targets: list[dict[str, int]], weights: Sequence[float] | None, what: str
) -> FloatArray:
    if weights is None or not targets and not any(weights):
        return vertices
    if len(weights) != len(targets):
        raise ReadError(f"{what} has {len(targets)} morph targets, but {len(weights)} weights")
    for target, weight in zip(targets, weights, strict=True):
        if weight and "POSITION" in target:
            offset = data.values(target["POSITION"], "VEC3")
            if len(offset) != len(vertices):
                raise ReadError(f"{what} has {len(vertices)} vertices, but a morph target of {len(offset)}")
            vertices = vertices + float(weight) * offset
    return vertices


def _joints(
    data: GltfData, attributes: dict[str, int], count: int, what: str
) -> tuple[IntArray, FloatArray] | tuple[None, None]:
    sets = sorted(name[len("JOINTS_") :] for name in attributes if name.startswith("JOINTS_"))
    if not sets:
        return None, None
    if any(f"WEIGHTS_{k}" not in attributes for k in sets):
        raise ReadError(f"{what} has joints without weights")
    joints = np.concatenate([data.values(attributes[f"JOINTS_{k}"], "VEC4") for k in sets], axis=1)
    weights = np.concatenate([data.values(attributes[f"WEIGHTS_{k}"], "VEC4") for k in sets], axis=1)
    if len(joints) != count or len(weights) != count:
        raise ReadError(f"{what} has {count} vertices, but {len(joints)} joints and {len(weights)} weights")
    weights = weights.astype(np.float64)
    total = weights.sum(axis=1, keepdims=True)
    if not (np.abs(total - 1.0) < 0.02).all():  # four shares of one byte are off by less
        raise ReadError(f"{what} has weights of joints that do not add up to 1")
    return joints.astype(np.int64), weights / total


def _draco(data: GltfData, extension: dict[str, Any], position: int, what: str) -> tuple[FloatArray, IntArray]:
    try:
        import DracoPy
    except ImportError as error:
        raise ReadError(
            f"{what} is compressed ({DRACO}), which needs DracoPy: pip install DracoPy; or {PLAIN}"
        ) from error
    try:
        mesh = DracoPy.decode(data.view(extension["bufferView"]))
        vertices, triangles = np.asarray(mesh.points, np.float64), np.asarray(mesh.faces, np.int64)
    except ReadError:
        raise
    except Exception as error:  # of any kind, as its stream is broken
        raise ReadError(f"{what}: DracoPy cannot decode it: {type(error).__name__}: {error}; {PLAIN}") from error
    count = data.item("accessors", position).get("count")
    if len(vertices) != count or triangles.ndim != 2:
        raise ReadError(f"{what} should have {count} vertices; its Draco stream has {len(vertices)}")
    check_indices(triangles, len(vertices), what)
    return vertices, triangles
