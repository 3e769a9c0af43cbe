# SPDX-License-Identifier: Apache-2.0
"""3MF: the build items of the model, each with its components where they are put, in the unit that the file states."""

from __future__ import annotations

import io
import posixpath
import zipfile
import zlib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import Collector, Content, FloatArray, IntArray, ReadError, check_indices
from shadow_tracer.ros.wire.mesh_files.xml_text import Element, floats, parse

_UNITS = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
# Extensions by the name spaces that a file may require: parts in several files, colours, groups of triangles.
_KNOWN = (
    _CORE,
    "http://schemas.microsoft.com/3dmanufacturing/material/2015/02",
    "http://schemas.microsoft.com/3dmanufacturing/production/2015/06",
    "http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07",
)
_MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_SHAPES = ("mesh", "components")
_MOST_PARTS = 1_000_000


def read_3mf(path: Path) -> Content:
    """All triangles that are built. Raises ReadError: an extension is required that is not known, beams or other
    shapes than meshes, an object that is not there, a broken archive."""
    try:
        with zipfile.ZipFile(path) as archive:
            return _Model(archive).content()
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
        raise ReadError(f"it is no 3MF: {error}; write the file again") from error


class _Model:
    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._files: dict[str, Element] = {}
        self._objects: dict[tuple[str, str], Element] = {}
        self._meshes: dict[tuple[str, str], tuple[FloatArray, IntArray]] = {}
        self._collector = Collector()
        self._visited = 0

    def content(self) -> Content:
        name = self._root_name()
        model = self._file(name)
        unit = model.get("unit", "millimeter")
        if unit not in _UNITS:
            raise ReadError(f"unit: expected one of {list(_UNITS)}, got {unit!r}")
        for item in model.iterfind("build/item"):
            self._build(_path(item, name), item, np.eye(4), 0)
        if not self._visited and model.find("resources/object") is not None:
            raise ReadError("it has objects, but builds none of them; export it with build items")
        return self._collector.content(unit=_UNITS[unit])

    def _root_name(self) -> str:
        for relation in parse(self._bytes("_rels/.rels")).iterfind("Relationship"):
            if relation.get("Type") == _MODEL:
                return relation.get("Target", "").lstrip("/")
        raise ReadError("it names no 3D model; write the file again")

    def _bytes(self, name: str) -> bytes:
        try:
            return self._archive.read(name)
        except (KeyError, RuntimeError) as error:
            raise ReadError(f"its part {name!r} cannot be read: {error}") from error

    def _file(self, name: str) -> Element:
        if name not in self._files:
            data = self._bytes(name)
            self._files[name] = model = parse(data)
            prefixes = model.get("requiredextensions", "").split()
            spaces = _name_spaces(data) if prefixes else {}
            required = [spaces.get(prefix, prefix) for prefix in prefixes]
            unknown = sorted(set(required) - set(_KNOWN))
            if unknown:
                raise ReadError(f"it requires the extension {', '.join(unknown)}, which is not read; export it without")
            for item in model.iterfind("resources/object"):
                self._objects[name, item.get("id", "")] = item
        return self._files[name]

    def _build(self, name: str, item: Element, place: FloatArray, depth: int) -> None:
        """Place the object that a build item or a component names."""
        self._visited += 1
        if depth > 100 or self._visited > _MOST_PARTS:
            raise ReadError("its components contain one another, or are too many")
        self._file(name)
        key = name, item.get("objectid", "")
        if key not in self._objects:
            raise ReadError(f"it refers to object {key[1]!r}, which is not there")
        place = place @ _transform(item)
        body = self._objects[key]
        shapes = [child.tag for child in body if child.tag not in ("metadatagroup", "metadata")]
        if len(shapes) != 1 or shapes[0] not in _SHAPES:
            raise ReadError(f"object {key[1]!r}: expected one of {list(_SHAPES)}, got {shapes}")
        if shapes == ["components"]:
            for component in body.iterfind("components/component"):
                self._build(_path(component, name), component, place, depth + 1)
            return
        if key not in self._meshes:
            self._meshes[key] = _mesh(body, f"object {key[1]!r}")
        self._collector.add(*self._meshes[key], place)


def _name_spaces(data: bytes) -> dict[str, str]:
    """Name spaces by their prefixes."""
    return dict(pair for _, pair in ElementTree.iterparse(io.BytesIO(data), events=["start-ns"]))


def _path(item: Element, name: str) -> str:
    """The part of the archive that an object is in; the attribute belongs to the production extension."""
    found = next((value for key, value in item.attrib.items() if key.endswith("}path")), "")
    return posixpath.normpath(found).lstrip("/") if found else name


def _transform(item: Element) -> FloatArray:
    """(4, 4) from the twelve numbers of a file, which multiply rows from the right."""
    matrix = np.eye(4)
    if "transform" in item.attrib:
        matrix[:3] = floats(item.get("transform"), "transform", 12).reshape(4, 3).T
    return matrix


def _mesh(body: Element, what: str) -> tuple[FloatArray, IntArray]:
    if body.find("mesh/beamlattice") is not None:
        raise ReadError(f"{what} is a lattice of beams, which is not read; export it as a mesh")
    try:
        vertices = np.array(
            [[item.attrib[name] for name in "xyz"] for item in body.iterfind("mesh/vertices/vertex")], np.float64
        ).reshape(-1, 3)
        triangles = np.array(
            [[item.attrib[name] for name in ("v1", "v2", "v3")] for item in body.iterfind("mesh/triangles/triangle")],
            np.int64,
        ).reshape(-1, 3)
    except (KeyError, ValueError, OverflowError) as error:
        raise ReadError(f"{what}: expected numbers for x, y, z, v1, v2, v3: {error}") from error
    check_indices(triangles, len(vertices), what)
    return vertices, triangles
