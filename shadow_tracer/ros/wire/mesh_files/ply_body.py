# SPDX-License-Identifier: Apache-2.0
"""The body of a PLY file: rows of numbers and of lists of numbers, as text or as bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.mesh_files.content import IntArray, ReadError, parse_numbers

_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}
_LONG = 1000  # values of a list; numpy cannot make records of any size


class Column(NamedTuple):
    """A property: its name, type as in numpy without byte order, and the type of its counts if it is a list."""

    name: str
    kind: str
    counts: str = ""


@dataclass
class Columns:
    """An element: its rows by property. A list is all its values and how many each row has."""

    count: int
    values: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    lists: dict[str, tuple[npt.NDArray[Any], IntArray]] = field(default_factory=dict)


def _short(name: str) -> ReadError:
    return ReadError(f"it is cut short within element {name!r}; write the file again")


def _numbered(name: str, count: float | str) -> int:
    try:
        number = int(count)
    except ValueError:
        number = -1
    if number < 0 or number != float(count):
        raise ReadError(f"a list of element {name!r} says that it has {count} values; write the file again")
    return number


class BinaryBody:
    """Bytes from ``position`` on, in the byte order "<" or ">"."""

    def __init__(self, data: bytes, position: int, order: str) -> None:
        self._data, self._position, self._order = data, position, order

    @property
    def left(self) -> str:
        """What has not been taken, "" if that is nothing but white space."""
        rest = len(self._data) - self._position
        return f"{rest} bytes" if rest > 64 or self._data[self._position :].strip() else ""

    def take(self, name: str, count: int, columns: Sequence[Column]) -> Columns:
        """The next ``count`` rows. Raises ReadError if there are fewer."""
        sizes = [self._first_count(column) if column.counts else 0 for column in columns[:1]]
        uniform = self._uniform(name, count, columns, sizes)
        return uniform if uniform is not None else self._one_by_one(name, count, columns)

    def _first_count(self, column: Column) -> int:
        kind = np.dtype(self._order + column.counts)
        if self._position + kind.itemsize > len(self._data):
            return 0
        return int(max(np.frombuffer(self._data, kind, 1, self._position)[0], 0))

    def _uniform(self, name: str, count: int, columns: Sequence[Column], sizes: list[int]) -> Columns | None:
        """Rows of one size in one go: no lists, or one in front that is everywhere as long as in the first row."""
        if any(column.counts for column in columns[1:]) or max(sizes, default=0) > _LONG:
            return None
        fields: list[Any] = []
        for k, column in enumerate(columns):
            kind = self._order + column.kind
            if column.counts:
                fields += [("n", self._order + column.counts), ("list", kind, (sizes[0],))]
            else:
                fields.append((f"v{k}", kind))
        record = np.dtype(fields)
        if self._position + count * record.itemsize > len(self._data):
            if not columns or not columns[0].counts:
                raise _short(name)
            return None
        rows = np.frombuffer(self._data, record, count, self._position)
        table = Columns(count)
        for k, column in enumerate(columns):
            if column.counts:
                if not (rows["n"] == sizes[0]).all():
                    return None
                table.lists[column.name] = rows["list"].reshape(-1), np.full(count, sizes[0], np.int64)
            else:
                table.values[column.name] = rows[f"v{k}"]
        self._position += count * record.itemsize
        return table

    def _one_by_one(self, name: str, count: int, columns: Sequence[Column]) -> Columns:
        found: dict[str, list[Any]] = {column.name: [] for column in columns}
        counts: dict[str, list[int]] = {column.name: [] for column in columns if column.counts}
        at = self._position
        try:
            for _ in range(count):
                for column in columns:
                    size = 1
                    if column.counts:
                        (number,) = struct.unpack_from(self._order + _CODES[column.counts], self._data, at)
                        size = _numbered(name, number)
                        counts[column.name].append(size)
                        at += int(column.counts[1])
                    code = f"{self._order}{size}{_CODES[column.kind]}"
                    found[column.name] += struct.unpack_from(code, self._data, at)
                    at += size * int(column.kind[1])
        except struct.error as error:
            raise _short(name) from error
        self._position = at
        return _table(count, columns, found, counts)


class TextBody:
    """Words of the body, whatever lines they stand in."""

    def __init__(self, data: bytes) -> None:
        self._words = data.decode("latin-1").split()
        self._position = 0

    @property
    def left(self) -> str:
        """What has not been taken, "" if nothing."""
        rest = len(self._words) - self._position
        return f"{rest} values" if rest else ""

    def take(self, name: str, count: int, columns: Sequence[Column]) -> Columns:
        """The next ``count`` rows. Raises ReadError if there are fewer, or a word is no number."""
        words, at = self._words, self._position
        if not any(column.counts for column in columns):
            end = at + count * len(columns)
            if end > len(words):
                raise _short(name)
            rows = _numbers(name, words[at:end], "f8").reshape(count, len(columns))
            self._position = end
            return Columns(count, {column.name: rows[:, k] for k, column in enumerate(columns)})
        found: dict[str, list[Any]] = {column.name: [] for column in columns}
        counts: dict[str, list[int]] = {column.name: [] for column in columns if column.counts}
        for _ in range(count):
            for column in columns:
                size = 1
                if column.counts:
                    if at >= len(words):
                        raise _short(name)
                    size = _numbered(name, words[at])
                    counts[column.name].append(size)
                    at += 1
                if at + size > len(words):
                    raise _short(name)
                found[column.name] += words[at : at + size]
                at += size
        self._position = at
        return _table(count, columns, {c.name: _numbers(name, found[c.name], c.kind) for c in columns}, counts)


def _numbers(name: str, words: list[str], kind: str) -> npt.NDArray[Any]:
    try:
        return parse_numbers(words, np.float64 if kind.startswith("f") else np.int64)
    except (ValueError, OverflowError) as error:
        raise ReadError(f"element {name!r} does not hold the numbers that the header names: {error}") from error


def _table(count: int, columns: Sequence[Column], found: dict[str, Any], counts: dict[str, list[int]]) -> Columns:
    table = Columns(count)
    for column in columns:
        values = np.asarray(found[column.name], np.float64 if column.kind.startswith("f") else np.int64)
        if column.counts:
            table.lists[column.name] = values, np.array(counts[column.name], np.int64)
        else:
            table.values[column.name] = values
    return table
