# SPDX-License-Identifier: Apache-2.0
"""COLLADA (.dae): the scene, every instance of every geometry where its nodes put it, in the unit that the file states.

``up_axis`` is not applied: axes stay as they are written, as in every other format.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from shadow_tracer.ros.wire.mesh_files.collada_mesh import read_geometry
from shadow_tracer.ros.wire.mesh_files.content import Collector, Content, FloatArray, IntArray, ReadError, counted
from shadow_tracer.ros.wire.mesh_files.xml_text import Element, floats, parse

_MOST_NODES = 1_000_000  # with all instances


def read_collada(path: Path) -> Content:
    """All triangles of the scene. Lines, splines and animations are named as left out.

    Raises:
        ReadError: skins and morphs (controllers), surfaces that are no meshes, what is not in the file, broken XML.
    """
    root = parse(path.read_bytes())
    if root.tag != "COLLADA":
        raise ReadError(f"it is no COLLADA: its root is {root.tag!r}")
    return _Scene(root).content()


class _Scene:
    def __init__(self, root: Element) -> None:
        self._root = root
        self._known: defaultdict[tuple[str, str], list[Element]] = defaultdict(list)
        for kind in ("geometry", "node", "visual_scene"):
            for element in root.iter(kind):
                self._known[kind, element.get("id", "")].append(element)
        self._collector = Collector()
        self._besides: Counter[str] = Counter()
        self._meshes: dict[str, tuple[FloatArray, IntArray]] = {}
        self._visited = 0

    def content(self) -> Content:
        for node in self._scene().iterfind("node"):
            self._visit(node, np.eye(4), ())
        self._besides["animations"] += len(self._root.findall("library_animations/animation"))
        if not self._meshes and next(self._root.iter("geometry"), None) is not None:
            raise ReadError("it has geometries, but no node of its scene places them; export a scene")
        return self._collector.content(counted(self._besides), self._unit())

    def _unit(self) -> float:
        unit = self._root.find("asset/unit")
        text = "1" if unit is None else unit.get("meter", "1")
        metres = float(floats(text, "asset/unit", 1)[0])
        if not 0.0 < metres < np.inf:
            raise ReadError(f"asset/unit: expected metres per unit, got {text!r}")
        return metres

    def _scene(self) -> Element:
        instance = self._root.find("scene/instance_visual_scene")
        if instance is not None:
            return self._find("visual_scene", instance.get("url"))
        scenes = self._root.findall("library_visual_scenes/visual_scene")
        if len(scenes) != 1:
            raise ReadError(f"it names no scene and has {len(scenes)}; export one scene")
        return scenes[0]

    def _find(self, kind: str, reference: str | None) -> Element:
        if not reference or not reference.startswith("#"):
            raise ReadError(f"it refers to the {kind} {reference!r}; only what is in the same file is read")
        found = self._known[kind, reference[1:]]
        if len(found) != 1:
            raise ReadError(f"it has {len(found)} times the {kind} {reference!r} that it refers to; expected it once")
        return found[0]

    def _visit(self, node: Element, place: FloatArray, above: tuple[Element, ...]) -> None:
        """Place what a node holds; ``above`` are the nodes that it is in."""
        self._visited += 1
        if any(node is other for other in above) or len(above) > 200 or self._visited > _MOST_NODES:
            raise ReadError(f"its node {node.get('id')!r} is found within itself, or instances are too many")
        above = (*above, node)
        for child in node:
            if child.tag in _TRANSFORMS:
                place = place @ _TRANSFORMS[child.tag](child)
            elif child.tag in ("lookat", "skew") and any(True for _ in _surfaces(node)):
                raise ReadError(f"node {node.get('id')!r} uses {child.tag!r}, which is not read; export it as a matrix")
        for child in node:
            if child.tag == "instance_geometry":
                vertices, triangles = self._mesh(child.get("url"))
                self._collector.add(vertices, triangles, place)
            elif child.tag == "instance_controller":
                raise ReadError(
                    f"node {node.get('id')!r} uses the controller {child.get('url')!r}: skins and morphs are not read; "
                    "apply them in the program that wrote it, and export without"
                )
            elif child.tag == "instance_node":
                self._visit(self._find("node", child.get("url")), place, above)
            elif child.tag == "node":
                self._visit(child, place, above)

    def _mesh(self, reference: str | None) -> tuple[FloatArray, IntArray]:
        geometry = self._find("geometry", reference)
        key = reference or ""
        if key not in self._meshes:
            self._meshes[key] = read_geometry(geometry, self._besides)
        return self._meshes[key]


def _surfaces(node: Element) -> list[Element]:
    kinds = ("instance_geometry", "instance_controller", "instance_node")
    return [item for kind in kinds for item in node.iter(kind)]


def _translate(item: Element) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, 3] = floats(item.text, "translate", 3)
    return matrix


def _scale(item: Element) -> FloatArray:
    return np.diag([*floats(item.text, "scale", 3), 1.0])


def _rotate(item: Element) -> FloatArray:
    """About an axis by an angle in degrees."""
    *axis, degrees = floats(item.text, "rotate", 4)
    length = float(np.linalg.norm(axis))
    matrix = np.eye(4)
    if degrees and not length:
        raise ReadError("rotate: expected an axis other than 0 0 0")
    if not degrees:
        return matrix
    x, y, z = np.array(axis) / length
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.deg2rad(degrees)
    matrix[:3, :3] += np.sin(angle) * across + (1.0 - np.cos(angle)) * (across @ across)
    return matrix


def _matrix(item: Element) -> FloatArray:
    matrix = floats(item.text, "matrix", 16).reshape(4, 4)
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise ReadError(f"matrix: expected the last row 0 0 0 1, got {matrix[3].tolist()}")
    return matrix


_TRANSFORMS = {"matrix": _matrix, "translate": _translate, "rotate": _rotate, "scale": _scale}
