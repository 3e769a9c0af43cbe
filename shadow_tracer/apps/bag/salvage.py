# SPDX-License-Identifier: Apache-2.0
"""Recordings that were cut off, because the recorder was killed or the disk full: what is whole is copied into a new
file with an index.

A message that is not whole is not used, and nor is what stands behind the first damage.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

MCAP_MAGIC = b"\x89MCAP0\r\n"
_BLOCK = 1 << 20
_SMALL_TABLES = ("schema", "metadata", "topics", "message_definitions")
_SQLITE_SIZE = slice(28, 32)  # of a database in pages; in force if the two counters below are equal
_SQLITE_COUNTERS = (slice(24, 28), slice(92, 96))


def unpack(source: Path, target: Path) -> bool:
    """Decompress a zstd file as far as it goes. Returns whether it is whole. Raises OSError if it cannot be written."""
    with source.open("rb") as packed, target.open("wb") as plain:
        decompressor = zstandard.ZstdDecompressor().decompressobj()
        whole = True
        for block in iter(lambda: packed.read(_BLOCK), b""):
            rest = block
            while rest:
                if decompressor.eof:  # another frame follows
                    decompressor = zstandard.ZstdDecompressor().decompressobj()
                try:
                    plain.write(decompressor.decompress(rest))
                except zstandard.ZstdError:
                    return False
                rest = decompressor.unused_data if decompressor.eof else b""
            whole = bool(decompressor.eof)
    return whole


def mcap_ends(file: Path) -> bool:
    """Whether an mcap file ends as one that was closed."""
    with file.open("rb") as stream:
        stream.seek(max(0, os.fstat(stream.fileno()).st_size - len(MCAP_MAGIC)))
        return stream.read() == MCAP_MAGIC


def mend_mcap(source: Path, target: Path) -> int:
    """Copy the whole messages of an mcap file that was cut off. Returns their number. Raises OSError."""
    writer = Writer(str(target), compression=CompressionType.NONE)
    writer.start(profile="ros2", library="shadow_tracer")
    schemas, channels, count = {0: 0}, {}, 0
    with source.open("rb") as stream:
        for record in _records(stream):
            if isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.schema_id in schemas:
                schema = schemas[record.schema_id]
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schema, record.metadata
                )
            elif isinstance(record, Message) and record.channel_id in channels:
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
                count += 1
    writer.finish()
    return count


def _records(stream: BinaryIO) -> Iterator[Any]:
    """Records of an mcap file, those in chunks included, up to the first damage."""
    reader = StreamReader(stream, emit_chunks=True, record_size_limit=os.fstat(stream.fileno()).st_size)
    seen: set[tuple[type, int]] = set()
    whole = stream.tell()
    with suppress(Exception):  # of the library: whatever damaged bytes lead it to
        for record in reader.records:
            inside = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
            whole = stream.tell()
            yield from _first(inside, seen)
    stream.seek(whole)
    yield from _first(_cut_chunk(stream), seen)


def _first(records: Any, seen: set[tuple[type, int]]) -> Iterator[Any]:
    """Messages, and of schemas and channels the first of each number: writers repeat them in chunks."""
    for record in records:
        if isinstance(record, (Schema, Channel)):
            if (type(record), record.id) in seen:
                continue
            seen.add((type(record), record.id))
        yield record


def _cut_chunk(stream: BinaryIO) -> Iterator[Any]:
    """Whole records of a chunk that the file ends in."""
    records = ReadDataStream(BytesIO(b""))
    with suppress(Exception):
        head = ReadDataStream(stream)
        if head.read1() != Opcode.CHUNK or head.read8() <= os.fstat(stream.fileno()).st_size - stream.tell():
            return  # what is there as a whole was looked at, and refused
        head.read(3 * 8 + 4)  # times, size, checksum
        compression = head.read_prefixed_string()
        head.read(8)
        records = ReadDataStream(BytesIO(_as_far_as_it_goes(compression, stream.read())))
    readers = {Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read}
    while True:
        try:
            opcode, length = records.read1(), records.read8()
            body = records.read(length)
            if len(body) < length:
                return
            part = ReadDataStream(BytesIO(body))
            record = Message.read(part, length) if opcode == Opcode.MESSAGE else readers[Opcode(opcode)](part)
        except Exception:  # the end, or damaged bytes
            return
        yield record


def _as_far_as_it_goes(compression: str, data: bytes) -> bytes:
    if compression == "zstd":
        plain = bytearray()
        decompressor = zstandard.ZstdDecompressor().decompressobj()
        with suppress(zstandard.ZstdError):
            for start in range(0, len(data), 4096):
                plain += decompressor.decompress(data[start : start + 4096])
        return bytes(plain)
    return bytes(LZ4FrameDecompressor().decompress(data)) if compression == "lz4" else data


def sqlite_is_whole(file: Path) -> bool:
    """Whether a database has all of its pages and no journal beside it with what it lacks."""
    return not _journals(file) and _pages(file)[1] <= file.stat().st_size


def _pages(file: Path) -> tuple[int, int]:
    """Size of a page and of the whole database as it says itself, in bytes."""
    with file.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100:
        return 100, 100
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else max(page, 512)
    counted = head[_SQLITE_COUNTERS[0]] == head[_SQLITE_COUNTERS[1]]
    return page, page * int.from_bytes(head[_SQLITE_SIZE], "big") if counted else 0


def _journals(file: Path) -> list[Path]:
    beside = (file.with_name(file.name + end) for end in ("-wal", "-journal"))
    return [path for path in beside if path.exists() and path.stat().st_size]


def mend_sqlite(source: Path, target: Path) -> int:
    """Copy the messages of a database that was cut off, with what its journal holds. Returns their number.

    Raises:
        OSError: a copy cannot be written.
        sqlite3.Error: it cannot be written, or even the topics are lost.
    """
    copy = target.with_name(f"{target.stem}.copy")
    _copy_whole_pages(source, copy)
    with closing(sqlite3.connect(copy)) as old, closing(sqlite3.connect(target)) as new:
        old.execute("PRAGMA writable_schema=ON")  # otherwise a table or an index that is lost forbids the others
        tables = dict(old.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall())
        if "topics" not in tables or "messages" not in tables:
            raise sqlite3.DatabaseError("no tables of a recording")
        count = 0
        for name in (*(name for name in _SMALL_TABLES if name in tables), "messages"):
            new.execute(tables[name])
            count = 0
            for row in _rows(old, name):
                new.execute(f"INSERT INTO {name} VALUES ({','.join('?' * len(row))})", row)
                count += 1
        new.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        new.commit()
    copy.unlink()
    return count


def _copy_whole_pages(source: Path, copy: Path) -> None:
    """Copy a database, apply its journal, and say in it how many pages there are.

    SQLite takes pages that are missing at the end for zeros unless the file says that it is shorter.
    """
    shutil.copyfile(source, copy)
    if journals := _journals(source):
        for path in journals:
            shutil.copyfile(path, copy.with_name(copy.name + path.name[len(source.name) :]))
        with closing(sqlite3.connect(copy)) as database:
            database.execute("PRAGMA journal_mode=DELETE").fetchall()
    page, size = _pages(copy)
    there = copy.stat().st_size
    if size > there:
        with copy.open("r+b") as stream:
            stream.truncate(there // page * page)
            stream.seek(_SQLITE_SIZE.start)
            stream.write((there // page).to_bytes(4, "big"))


def _rows(database: sqlite3.Connection, table: str) -> Iterator[tuple[Any, ...]]:
    """Rows of a table in the order they were written, up to the first that is not whole."""
    with suppress(sqlite3.DatabaseError):
        yield from database.execute(f"SELECT * FROM {table} ORDER BY rowid")
