# SPDX-License-Identifier: Apache-2.0
"""glTF 2.0: the default scene, every instance of every mesh where its nodes put it.

What a file says that a reader must know (``extensionsRequired``) is looked at before anything else.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import Collector, Content, FloatArray, ReadError, counted
from shadow_tracer.ros.wire.mesh_files.gltf_data import GltfData
from shadow_tracer.ros.wire.mesh_files.gltf_mesh import DRACO, PLAIN, Primitive, read_mesh

_INSTANCES = "EXT_mesh_gpu_instancing"
_VISIBILITY = "KHR_node_visibility"
_APPLIED = {DRACO, _INSTANCES, _VISIBILITY, "KHR_mesh_quantization"}
# These change what a surface looks like, or tell about it: never where it is.
_HARMLESS = {"CESIUM_primitive_outline", "EXT_mesh_features", "EXT_structural_metadata", "KHR_animation_pointer"}
_HARMLESS_STARTS = (
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_xmp",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_",
)
_MOVING = {"CESIUM_RTC"}  # moves geometry even where it is only used, not required


def read_gltf(path: Path) -> Content:
    """All triangles of the default scene: meshes with their morph weights and skins as they stand in the file.

    Points, lines, animations, hidden nodes and meshes outside that scene are named as left out.

    Raises:
        ReadError: an extension is required that is not known here, data is missing or does not fit together.
    """
    data = GltfData(path)
    _check_extensions(data.root)
    return _Scene(data).content()


def _check_extensions(root: dict[str, Any]) -> None:
    wanted = set(root.get("extensionsRequired", [])) | set(root.get("extensionsUsed", [])) & _MOVING
    unknown = sorted(
        name for name in wanted if name not in _APPLIED | _HARMLESS and not name.startswith(_HARMLESS_STARTS)
    )
    if unknown:
        cure = PLAIN if any("meshopt" in name for name in unknown) else "export it without"
        raise ReadError(f"its extensionsRequired has {', '.join(unknown)}, which is not read; {cure}")


class _Scene:
    def __init__(self, data: GltfData) -> None:
        self._data = data
        self._collector = Collector()
        self._besides: Counter[str] = Counter()
        self._meshes: dict[Any, list[Primitive]] = {}
        self._nodes = [data.item("nodes", k) for k in range(len(data.root.get("nodes", [])))]
        self._parents: dict[int, int] = {}
        for number, node in enumerate(self._nodes):
            for child in node.get("children", []):
                data.item("nodes", child)
                if child in self._parents:
                    raise ReadError(f"nodes[{child}] is the child of two nodes")
                self._parents[child] = number

    def content(self) -> Content:
        seen: set[int] = set()
        stack = [(root, np.eye(4)) for root in reversed(self._roots())]
        while stack:
            number, parent = stack.pop()
            node = self._data.item("nodes", number)
            if number in seen:
                raise ReadError(f"nodes[{number}] is found twice in its scene")
            seen.add(number)
            if node.get("extensions", {}).get(_VISIBILITY, {}).get("visible", True) is False:
                self._besides["hidden nodes"] += 1
                continue
            place = parent @ _matrix(node, number)
            if "mesh" in node:
                self._place(node, number, place)
            stack += [(child, place) for child in reversed(node.get("children", []))]
        outside = sum("mesh" in node for number, node in enumerate(self._nodes) if number not in seen)
        hidden = self._besides["hidden nodes"]
        self._besides["nodes with meshes that are hidden" if hidden else "nodes with meshes outside the scene"] += (
            outside
        )
        self._besides["animations"] += len(self._data.root.get("animations", []))
        if not seen and self._data.root.get("meshes"):
            raise ReadError("it has meshes, but no node of its scene places them; export a scene")
        return self._collector.content(counted(self._besides), stated=self._units())

    def _roots(self) -> list[int]:
        root = self._data.root
        if not root.get("scenes"):
            return [number for number in range(len(self._nodes)) if number not in self._parents]
        return list(self._data.item("scenes", root.get("scene", 0)).get("nodes", []))

    def _units(self) -> frozenset[str]:
        """Units that other programs write beside: the format itself knows metres only."""
        root = self._data.root
        meshes = [root["meshes"][number] for number, _ in self._meshes]
        items = [root.get("asset", {}), *root.get("scenes", []), *meshes]
        extras = [item["extras"] for item in items if isinstance(item.get("extras"), dict)]
        return frozenset(str(extra["units"]) for extra in extras if "units" in extra)

    def _place(self, node: dict[str, Any], number: int, place: FloatArray) -> None:
        weights = node.get("weights")
        key = (node["mesh"], None if weights is None else tuple(weights))
        if key not in self._meshes:
            self._meshes[key] = read_mesh(self._data, node["mesh"], weights, self._besides)
        extension = node.get("extensions", {}).get(_INSTANCES)
        if "skin" in node:
            if extension is not None:
                raise ReadError(f"nodes[{number}] has a skin and {_INSTANCES}, which is not read; export it without")
            joints = self._joint_matrices(node["skin"])
            for primitive in self._meshes[key]:
                self._collector.add(_skinned(primitive, joints, f"nodes[{number}]"), primitive.triangles)
            return
        places = [place] if extension is None else [place @ instance for instance in self._instances(extension, number)]
        for primitive in self._meshes[key]:
            for where in places:
                self._collector.add(primitive.vertices, primitive.triangles, where)

    def _instances(self, extension: dict[str, Any], number: int) -> list[FloatArray]:
        attributes = extension.get("attributes", {})
        kinds = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}
        found = {
            name: self._data.values(attributes[name], kind).astype(np.float64)
            for name, kind in kinds.items()
            if name in attributes
        }
        what = f"nodes[{number}].extensions.{_INSTANCES}"
        if len({len(values) for values in found.values()}) != 1:
            raise ReadError(f"{what}: expected as many translations as rotations and scales, at least one of them")
        names = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        count = len(next(iter(found.values())))
        return [_trs({names[name]: values[k] for name, values in found.items()}, what) for k in range(count)]

    def _joint_matrices(self, number: int) -> FloatArray:
        """(J, 4, 4) where each joint of a skin takes the mesh."""
        skin = self._data.item("skins", number)
        joints = skin.get("joints", [])
        inverse = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        if "inverseBindMatrices" in skin:
            inverse = self._data.values(skin["inverseBindMatrices"], "MAT4").reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(inverse) < len(joints):
                raise ReadError(f"skins[{number}] has {len(joints)} joints, but {len(inverse)} matrices")
        return np.stack([self._world(joint) @ inverse[k] for k, joint in enumerate(joints)])

    def _world(self, number: int) -> FloatArray:
        place = _matrix(self._data.item("nodes", number), number)
        for _ in range(len(self._nodes)):
            if number not in self._parents:
                return place
            number = self._parents[number]
            place = _matrix(self._nodes[number], number) @ place
        raise ReadError(f"nodes[{number}] is found within itself")


def _skinned(primitive: Primitive, joints: FloatArray, what: str) -> FloatArray:
    if primitive.joints is None or primitive.weights is None:
        raise ReadError(f"{what} has a skin, but its mesh has no joints")
    if int(primitive.joints.max(initial=0)) >= len(joints):
        raise ReadError(f"{what} uses joint {int(primitive.joints.max())} of a skin of {len(joints)}")
    points = np.concatenate([primitive.vertices, np.ones((len(primitive.vertices), 1))], axis=1)
    moved = np.zeros((len(points), 3))
    for column in range(primitive.joints.shape[1]):
        share = primitive.weights[:, column, None]
        moved += share * np.einsum("vij,vj->vi", joints[primitive.joints[:, column]][:, :3], points)
    return moved


def _matrix(node: dict[str, Any], number: int) -> FloatArray:
    """(4, 4) place of a node within its parent."""
    if "matrix" not in node:
        return _trs(node, f"nodes[{number}]")
    matrix = _numbers(node["matrix"], 16, f"nodes[{number}].matrix").reshape(4, 4).T
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise ReadError(f"nodes[{number}].matrix: expected the last row (0, 0, 0, 1), got {matrix[3].tolist()}")
    return matrix


def _trs(node: dict[str, Any], what: str) -> FloatArray:
    matrix = np.eye(4)
    x, y, z, w = quaternion = _numbers(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), 4, f"{what}.rotation")
    length = float(quaternion @ quaternion)
    if not 0.8 < length < 1.25:  # quantized ones are off by far less
        raise ReadError(f"{what}.rotation: expected a unit quaternion, got {quaternion.tolist()}")
    s = 2.0 / length
    matrix[:3, :3] = (
        (1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
        (s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
        (s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
    )
    matrix[:3, :3] *= _numbers(node.get("scale", (1.0, 1.0, 1.0)), 3, f"{what}.scale")
    matrix[:3, 3] = _numbers(node.get("translation", (0.0, 0.0, 0.0)), 3, f"{what}.translation")
    return matrix


def _numbers(value: Any, count: int, what: str) -> FloatArray:
    try:
        numbers = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ReadError(f"{what}: expected {count} finite numbers, got {value!r}")
    return numbers
