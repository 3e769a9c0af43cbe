# SPDX-License-Identifier: Apache-2.0
"""The beginnings of the messages of an mcap file, by its index.

Of a chunk that is not compressed nothing else is read; a compressed one is unpacked as far as is needed. A depth image
is 600 kB, of which a planner wants 40 bytes.

A chunk's checksum needs all of it. Whoever plays the images in it checks it then; chunks without any message that will
be read again are checked here.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from heapq import merge
from pathlib import Path
from typing import Any
from zlib import crc32

import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader

from shadow_tracer.ros.wire.messages import MessageError

_INDEX, _MESSAGE = 0x07, 0x05  # opcodes
_RECORD = struct.Struct("<BQ")  # opcode and length
_CHUNK = struct.Struct("<QQQII")  # times, size and checksum unpacked, length of the name of the compression
_FRONT = struct.Struct("<BQHIQQ")  # a message before its data: record, channel, number, times
HEADER = 512  # bytes in which the header of a message mostly is
_MOST = 1 << 40  # bytes of a message that is wanted whole


class HeadsError(Exception):
    """The index of a file does not fit to what is in it."""


@dataclass(frozen=True)
class Head:
    """A message, as much of it as was wanted.

    Attributes:
        topic: its topic.
        time: log time [ns].
        data: its first bytes.
        size: how many it has.
        rest: reads all of them.
    """

    topic: str
    time: int
    data: bytes
    size: int
    rest: Callable[[], bytes]


class Heads:
    """An mcap file with an index. Use as a context manager.

    Args:
        path: the file.

    Raises:
        HeadsError: it has none, or its chunks are compressed in a way that is not known here.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        try:
            summary = make_reader(self._file).get_summary()
            if summary is None or not summary.chunk_indexes:
                raise HeadsError(f"{path}: no index")
            if not {chunk.compression for chunk in summary.chunk_indexes} <= {"", "zstd"}:
                raise HeadsError(f"{path}: another compression")
            self._chunks = summary.chunk_indexes
            self._topics = {number: channel.topic for number, channel in summary.channels.items()}
        except BaseException as error:
            self._file.close()
            if isinstance(error, (McapError, struct.error, ValueError, UnicodeDecodeError)):
                raise HeadsError(f"{path}: {error}") from error
            raise

    def __enter__(self) -> Heads:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, wanted: Mapping[str, int | None], again: Collection[str]) -> Iterator[Head]:
        """Messages in the order in which rosbags gives them.

        Args:
            wanted: of each topic how many bytes at the beginning of its messages, None being all.
            again: topics that will be read again, by somebody who checks the checksums of chunks.

        Raises:
            HeadsError: the index does not fit.
        """
        most = {n: wanted[topic] for n, topic in self._topics.items() if topic in wanted}
        trusted = {n for n, topic in self._topics.items() if topic in again}
        parts = [
            self._of_chunk(chunk, most, not trusted & chunk.message_index_offsets.keys())
            for chunk in self._chunks
            if most.keys() & chunk.message_index_offsets.keys()
        ]
        try:
            for *_, head in merge(*parts, key=lambda row: row[:2]):
                if head is not None:
                    yield head
        except (struct.error, zstandard.ZstdError, EOFError) as error:
            raise HeadsError(f"{self._file.name}: {error}") from error

    def _of_chunk(
        self, chunk: Any, most: Mapping[int, int | None], check: bool
    ) -> Iterator[tuple[int, int, Head | None]]:
        """Rows of a chunk by time, the first one without a message: until it is asked for more, nothing is read."""
        start = chunk.chunk_start_offset
        yield chunk.message_start_time, 0, None
        data = _Chunk(self._file.fileno(), chunk, check)
        for time, place, channel in sorted(self._index(chunk, most)):
            opcode, length, found, _, logged, _ = _FRONT.unpack(data.read(place, _FRONT.size))
            size, first = length - (_FRONT.size - _RECORD.size), place + _FRONT.size
            if (opcode, found, logged) != (_MESSAGE, channel, time) or not 0 <= size <= data.size - first:
                raise HeadsError(f"{self._file.name}: chunk at {start}: the index names another message")
            limit = most[channel]
            head = data.read(first, min(size, _MOST if limit is None else limit))
            yield time, start, Head(self._topics[channel], time, head, size, lambda: data.read(first, size))  # noqa: B023

    def _index(self, chunk: Any, channels: Collection[int]) -> Iterator[tuple[int, int, int]]:
        """Time, place in the chunk and channel of its messages."""
        start = chunk.chunk_start_offset + chunk.chunk_length
        rows = os.pread(self._file.fileno(), chunk.message_index_length, start)
        for channel in channels & chunk.message_index_offsets.keys():
            at = chunk.message_index_offsets[channel] - start
            if at < 0:
                raise HeadsError(f"{self._file.name}: chunk at {start}: its index stands elsewhere")
            opcode, length, found, size = struct.unpack_from("<BQHI", rows, at)
            if (opcode, length, found) != (_INDEX, 6 + size, channel) or size % 16 or at + 15 + size > len(rows):
                raise HeadsError(f"{self._file.name}: chunk at {start}: its index is damaged")
            for time, place in struct.iter_unpack("<QQ", rows[at + 15 : at + 15 + size]):
                yield time, place, channel


class _Chunk:
    """The contents of a chunk, unpacked as far as they were asked for."""

    def __init__(self, file: int, chunk: Any, check: bool) -> None:
        self.size: int = chunk.uncompressed_size
        front = os.pread(file, _RECORD.size + _CHUNK.size, chunk.chunk_start_offset)
        _, _, size, checksum, name = _CHUNK.unpack_from(front, _RECORD.size)
        if (size, name) != (self.size, len(chunk.compression)):
            raise HeadsError(f"chunk at {chunk.chunk_start_offset}: the index says another size")
        self._file = file
        self._start = chunk.chunk_start_offset + len(front) + name + 8
        self._unpacked: Any = None
        if chunk.compression:
            packed = os.pread(file, chunk.compressed_size, self._start)
            self._unpacked = zstandard.ZstdDecompressor().stream_reader(packed)
        self._known = bytearray()
        if check and checksum and crc32(self.read(0, self.size)) != checksum:
            raise HeadsError(f"chunk at {chunk.chunk_start_offset}: its checksum is another")

    def read(self, start: int, count: int) -> bytes:
        """Some bytes. Raises EOFError if there are not so many."""
        if start + count > self.size:
            raise EOFError("a message ends behind its chunk")
        if self._unpacked is None:
            found = os.pread(self._file, count, self._start + start)
        else:
            if len(self._known) < start + count:
                self._known += self._unpacked.read(start + count - len(self._known))
            found = bytes(self._known[start : start + count])
        if len(found) < count:
            raise EOFError("a chunk ends within a message")
        return found


def header_of(data: bytes) -> tuple[int, str]:
    """Stamp [ns] and frame of a message that begins with a header, from plain CDR. Raises MessageError."""
    order = ">" if data[1:2] == b"\0" else "<"
    try:
        seconds, nanoseconds, size = struct.unpack_from(f"{order}iII", data, 4)
        name = data[16 : 16 + size].decode() if size else ""
    except (struct.error, UnicodeDecodeError) as error:
        raise MessageError(f"header: cannot be read: {error}") from error
    if len(data) < 16 + size:
        raise MessageError("header: the message ends within it")
    return seconds * 1_000_000_000 + nanoseconds, name.rstrip("\0")


def has_header(name: str, data: bytes) -> bool:
    """Whether the header of a message, which begins with one, is in its first bytes; a mesh has none."""
    if name == "mesh" or len(data) < HEADER:
        return True
    try:
        header_of(data)
    except MessageError:
        return False
    return True
