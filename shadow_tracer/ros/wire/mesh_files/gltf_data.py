# SPDX-License-Identifier: Apache-2.0
"""The data of a glTF 2.0 file: its JSON, buffers and accessors, from .gltf or .glb."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.mesh_files.content import ReadError

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_LARGEST = {"i1": 127.0, "u1": 255.0, "i2": 32767.0, "u2": 65535.0}
_MOST_ZEROS = 100_000_000  # values of an accessor without data
_CUT = "it is cut short or broken; write the file again"


class GltfData:
    """A file and what it refers to.

    Attributes:
        root: its JSON.
    """

    def __init__(self, path: Path) -> None:
        self._folder = path.parent
        self.root, self._binary = _open(path.read_bytes())
        version = str(self.root.get("asset", {}).get("version", "1.0"))
        if not version.startswith("2."):
            raise ReadError(f"it is glTF {version}; expected 2.0: convert it")
        self._buffers: dict[int, bytes] = {}

    def item(self, kind: str, number: Any) -> dict[str, Any]:
        """Number ``number`` of a list at the root. Raises ReadError if there is none."""
        items = self.root.get(kind, [])
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(items):
            raise ReadError(f"it refers to number {number} of {len(items)} {kind}")
        found = items[number]
        if not isinstance(found, dict):
            raise ReadError(f"{kind}[{number}] is not an object")
        return found

    def has_data(self, accessor: int) -> bool:
        """Whether an accessor has values of its own, not only a count."""
        return bool({"bufferView", "sparse"} & self.item("accessors", accessor).keys())

    def values(self, accessor: int, kind: str) -> npt.NDArray[Any]:
        """Values of an accessor, sparse ones replaced, normalized ones as float64.

        Args:
            kind: type that it must have, such as "VEC3".

        Returns:
            (count, components) in the type of the file, or float64 where that is normalized.
        """
        item = self.item("accessors", accessor)
        what = f"accessors[{accessor}]"
        if item.get("type") != kind or item.get("componentType") not in _TYPES:
            got = f"{item.get('type')} of component type {item.get('componentType')}"
            raise ReadError(f"{what}: expected {kind} of one of the types {list(_TYPES)}, got {got}")
        dtype, width, count = np.dtype(_TYPES[item["componentType"]]), _SIZES[kind], _whole(item, "count", what, None)
        if "bufferView" in item:
            values = self._array(item["bufferView"], item, dtype, width, count, what)
        elif count * width > _MOST_ZEROS:
            raise ReadError(f"{what} has {count} elements and no data")
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in item:
            values = self._replaced(values, item["sparse"], what)
        if item.get("normalized"):
            if dtype.str[1:] not in _LARGEST:
                raise ReadError(f"{what}: normalized is for integers of one or two bytes")
            return np.maximum(values / _LARGEST[dtype.str[1:]], -1.0)
        return values

    def view(self, number: int) -> bytes:
        """The bytes of a buffer view."""
        view = self.item("bufferViews", number)
        what = f"bufferViews[{number}]"
        offset, length = _whole(view, "byteOffset", what, 0), _whole(view, "byteLength", what, None)
        data = self._buffer(view.get("buffer"))
        if offset + length > len(data):
            raise ReadError(f"{what} needs {offset + length} bytes of a buffer of {len(data)}; {_CUT}")
        return data[offset : offset + length]

    def _array(
        self, view: int, item: dict[str, Any], dtype: np.dtype[Any], width: int, count: int, what: str
    ) -> npt.NDArray[Any]:
        data, offset = self.view(view), _whole(item, "byteOffset", what, 0)
        size = dtype.itemsize * width
        stride = _whole(self.item("bufferViews", view), "byteStride", what, 0) or size
        needed = offset + stride * (count - 1) + size if count else 0
        if stride < size or needed > len(data):
            raise ReadError(f"{what} needs {needed} bytes of a buffer view of {len(data)}; {_CUT}")
        return (
            np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))
            if count
            else np.zeros((0, width), dtype)
        )

    def _replaced(self, values: npt.NDArray[Any], sparse: dict[str, Any], what: str) -> npt.NDArray[Any]:
        what += ".sparse"
        count = _whole(sparse, "count", what, None)
        where, new = sparse["indices"], sparse["values"]
        if where.get("componentType") not in (5121, 5123, 5125):
            raise ReadError(f"{what}.indices: expected unsigned integers, got type {where.get('componentType')}")
        dtype = np.dtype(_TYPES[where["componentType"]])
        rows = self._array(where["bufferView"], where, dtype, 1, count, what)[:, 0]
        if count and int(rows.max()) >= len(values):
            raise ReadError(f"{what}.indices lead to element {int(rows.max())} of {len(values)}")
        values = values.copy()
        values[rows] = self._array(new["bufferView"], new, values.dtype, values.shape[1], count, what)
        return values

    def _buffer(self, number: Any) -> bytes:
        if number not in self._buffers:
            buffer = self.item("buffers", number)
            self._buffers[number] = data = self._load(number, buffer)
            length = _whole(buffer, "byteLength", f"buffers[{number}]", None)
            if length > len(data):
                raise ReadError(f"buffers[{number}] should have {length} bytes and has {len(data)}; {_CUT}")
        return self._buffers[number]

    def _load(self, number: int, buffer: dict[str, Any]) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            if number == 0 and self._binary is not None:
                return self._binary
            raise ReadError(f"buffers[{number}] has no data; {_CUT}")
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            try:
                return base64.b64decode(text, validate=True) if head.endswith(";base64") else unquote_bytes(text)
            except binascii.Error as error:
                raise ReadError(f"buffers[{number}] is not base64: {error}") from error
        path = self._folder / unquote(uri)
        if "://" in uri or not path.is_file():
            raise ReadError(f"its buffer {uri!r} is not there; put the file beside it")
        return path.read_bytes()


def unquote_bytes(text: str) -> bytes:
    """Bytes of a data URI that is not base64."""
    return unquote(text, encoding="latin-1").encode("latin-1")


def _whole(item: dict[str, Any], name: str, what: str, default: int | None) -> int:
    value = item.get(name, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ReadError(f"{what}.{name}: expected a whole number, got {value!r}")
    return value


def _open(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """JSON and binary chunk."""
    binary = None
    if data[:4] == b"glTF":
        if len(data) < 20 or int.from_bytes(data[8:12], "little") > len(data):
            raise ReadError(_CUT)
        _, version, length = struct.unpack_from("<4sII", data)
        if version != 2:
            raise ReadError(f"it is glTF {version}; expected 2.0: convert it")
        chunks, at = [], 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > length:
                raise ReadError(_CUT)
            chunks.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        if not chunks or chunks[0][0] != b"JSON":
            raise ReadError("it does not begin with JSON; write the file again")
        binary = next((chunk for kind, chunk in chunks[1:2] if kind == b"BIN\0"), None)
        data = chunks[0][1]
    try:
        root = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ReadError(f"it is no glTF: {error}") from error
    if not isinstance(root, dict):
        raise ReadError("it is no glTF: expected an object")
    return root, binary
