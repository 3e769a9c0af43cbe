# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 1 that were cut off, such as ``*.bag.active``: their messages up to there, in a new bag with an index."""

from __future__ import annotations

import struct
from bz2 import BZ2Decompressor
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import Reader, ReaderError, Writer

_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"
Fields = dict[bytes, bytes]


def ros1_is_whole(file: Path) -> bool:
    """Whether a bag has its index. Raises OSError."""
    reader = Reader(file)
    try:
        reader.open()
    except (ReaderError, AssertionError, struct.error, IndexError):  # the index is absent, cut off or something else
        return False
    reader.close()
    return True


def mend_ros1(source: Path, target: Path) -> int:
    """Copy the whole messages of a bag that was cut off. Returns their number. Raises OSError."""
    connections: dict[bytes, Any] = {}
    known: dict[tuple[Any, ...], Any] = {}
    count = 0
    with source.open("rb") as stream, Writer(target) as writer:
        stream.readline()  # version
        for fields, data in _messages(stream):
            number = fields[b"conn"]
            if fields[b"op"] == _MESSAGE and number in connections:
                seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
                writer.write(connections[number], seconds * 10**9 + nanoseconds, data)
                count += 1
            elif fields[b"op"] == _CONNECTION and number not in connections:
                topic, kind, how = _connection(fields, data)
                key = (topic, kind, *how.values())
                if key not in known:
                    known[key] = writer.add_connection(topic, kind, **how)
                connections[number] = known[key]
    return count


def _connection(fields: Fields, data: bytes) -> tuple[str, str, dict[str, Any]]:
    """Topic, type by its name in ROS 2, and what else rosbags needs of a connection."""
    about = {key: value.decode() for key, value in _fields(data).items()}
    package, _, name = about[b"type"].partition("/")
    how = {
        "msgdef": about[b"message_definition"],
        "md5sum": about[b"md5sum"],
        "callerid": about.get(b"callerid"),
        "latching": int(about[b"latching"]) if about.get(b"latching") else None,
    }
    return fields[b"topic"].decode(), f"{package}/msg/{name}", how


def _messages(stream: BinaryIO) -> Iterator[tuple[Fields, bytes]]:
    """Records of messages and connections, those in chunks included, up to the first damage."""
    for fields, data, whole in _records(stream):
        if fields.get(b"op") == _CHUNK:
            plain = _unpacked(fields.get(b"compression", b"none"), data)
            for inner, content, complete in _records(BytesIO(plain)):
                if complete and {b"op", b"conn"} <= inner.keys():
                    yield inner, content
        elif whole and fields.get(b"op") == _CONNECTION and b"conn" in fields:
            yield fields, data


def _records(stream: BinaryIO) -> Iterator[tuple[Fields, bytes, bool]]:
    """Header, data and whether the data are all there, of one record after the other."""
    while True:
        try:
            fields = _fields(_sized(stream))
            (size,) = struct.unpack("<I", stream.read(4))
        except (struct.error, ValueError):
            return
        data = stream.read(size)
        yield fields, data, len(data) == size
        if len(data) < size:
            return


def _sized(stream: BinaryIO) -> bytes:
    (size,) = struct.unpack("<I", stream.read(4))
    data = stream.read(size)
    if len(data) < size:
        raise ValueError("the file ends in a header")
    return data


def _fields(header: bytes) -> Fields:
    fields: Fields = {}
    place = 0
    while place < len(header):
        (size,) = struct.unpack_from("<I", header, place)
        name, separator, value = header[place + 4 : place + 4 + size].partition(b"=")
        if not separator or place + 4 + size > len(header):
            raise ValueError("not a header")
        fields[name] = value
        place += 4 + size
    return fields


def _unpacked(compression: bytes, data: bytes) -> bytes:
    """The contents of a chunk as far as they go."""
    if compression == b"none":
        return data
    decompressor: Any = BZ2Decompressor() if compression == b"bz2" else LZ4FrameDecompressor()
    plain = bytearray()
    with suppress(OSError, EOFError, RuntimeError):  # damaged: what came out before is whole
        for start in range(0, len(data), 4096):
            plain += decompressor.decompress(data[start : start + 4096])
    return bytes(plain)
