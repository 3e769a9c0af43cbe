# SPDX-License-Identifier: Apache-2.0
"""A cursor over serialised ROS messages that never reads past their end, and its counterpart that writes them.

Plain CDR: two bytes that say so and give the byte order, two of options, then the fields one after the other. A number
of n bytes stands at a multiple of n, counted from byte 4; what lies in the gaps is arbitrary. A string or a sequence is
a u32 count and its elements; a string counts the zero byte at its end. No ROS here.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.parts import PartError

HEADER = 4  # bytes of encapsulation, from the end of which alignment counts
SLACK = 7  # transports may pad the end; more than that means another layout, which must not pass for an empty message
LONGEST_NAME = 4096  # bytes of a name; longer ones are garbage, and the names of parts are kept
_ENDIAN = {b"\x00\x00": ">", b"\x00\x01": "<"}


class MeshMessageError(PartError):
    """The bytes are not a usable message; the text says where and why. Nothing was kept of them."""


@lru_cache(maxsize=64)
def _packing(layout: str) -> struct.Struct:
    return struct.Struct(layout)


class Reader:
    """Cursor over the bytes of a message.

    Every method that reads moves on, and raises :class:`MeshMessageError` naming the field if the message ends before
    the field does. Counts are compared with the bytes that are left before anything is allocated.

    Args:
        data: the serialised message; any bytes are survived.

    Attributes:
        order: byte order of the message, "<" or ">".
        position: byte that is read next.
        scope: prefix of field names in errors, such as "markers[2].".

    Raises:
        MeshMessageError: not plain CDR.
    """

    __slots__ = ("_data", "_end", "order", "position", "scope")

    def __init__(self, data: bytes) -> None:
        if len(data) < HEADER:
            raise MeshMessageError(f"header: expected 4 bytes of encapsulation, got {len(data)}")
        kind = bytes(data[:2])
        if kind not in _ENDIAN:
            raise MeshMessageError(f"header: expected plain CDR (00 00 or 00 01), got {kind.hex(' ')}")
        self._data = data
        self._end = len(data)
        self.order = _ENDIAN[kind]
        self.position = HEADER
        self.scope = ""

    @property
    def left(self) -> int:
        """Bytes that are left."""
        return self._end - self.position

    def align(self, size: int) -> None:
        """Step over the gap before a number of ``size`` bytes; it may end behind the message."""
        self.position += (HEADER - self.position) % size

    def numbers(self, layout: str, size: int, field: str) -> tuple[Any, ...]:
        """Consecutive numbers without gaps.

        Args:
            layout: characters of :mod:`struct`, without byte order.
            size: bytes of the first number, which is the largest.
        """
        self.align(size)
        packing = _packing(self.order + layout)
        start = self.position
        if start + packing.size > self._end:
            raise MeshMessageError(
                f"{self.scope}{field}: expected {packing.size} bytes at byte {start}, but the message ends at byte "
                f"{self._end}"
            )
        self.position = start + packing.size
        return packing.unpack_from(self._data, start)

    def peek(self, layout: str, size: int) -> tuple[Any, ...] | None:
        """What :meth:`numbers` would read, without moving on; None if the message ends before."""
        packing = _packing(self.order + layout)
        start = self.position + (HEADER - self.position) % size
        return None if start + packing.size > self._end else packing.unpack_from(self._data, start)

    def count(self, field: str) -> int:
        """A u32 number of elements."""
        self.align(4)
        start = self.position
        if start + 4 > self._end:
            raise MeshMessageError(
                f"{self.scope}{field}: expected a count at byte {start}, but the message ends at byte {self._end}"
            )
        self.position = start + 4
        return int(_packing(self.order + "I").unpack_from(self._data, start)[0])

    def flag(self, field: str) -> bool:
        """A bool, one byte that is 0 or 1."""
        (value,) = self.numbers("B", 1, field)
        if value > 1:
            raise MeshMessageError(f"{self.scope}{field}: expected 0 or 1, got {value}")
        return bool(value)

    def skip(self, count: int, size: int, alignment: int, field: str) -> int:
        """Step over elements.

        Args:
            count: number of elements; there is no gap before none.
            size: bytes of one.
            alignment: bytes of the first number of an element.

        Returns:
            where they start.
        """
        if count == 0:
            return self.position
        self.align(alignment)
        start = self.position
        if start + count * size > self._end:
            raise MeshMessageError(
                f"{self.scope}{field}: {count} of them need {count * size} bytes, but {max(0, self._end - start)} are "
                "left"
            )
        self.position = start + count * size
        return start

    def array(self, count: int, columns: int, kind: str, field: str) -> npt.NDArray[Any]:
        """A sequence of ``count`` rows, (count, columns), as a read-only view in the byte order of the message.

        Args:
            kind: numpy's name of a number, such as "f8", which need not lie aligned in memory.
        """
        dtype = np.dtype(self.order + kind)
        start = self.skip(count, columns * dtype.itemsize, dtype.itemsize, field)
        if count == 0:
            return np.empty((0, columns), dtype)
        return np.frombuffer(self._data, dtype, count * columns, start).reshape(count, columns)

    def skip_sequence(self, size: int, alignment: int, field: str) -> None:
        """Step over a count and as many elements of ``size`` bytes."""
        self.skip(self.count(field), size, alignment, field)

    def text(self, field: str) -> str:
        """A name. What is no UTF-8 is replaced; it ends before the first zero byte, as in the messages of rclpy."""
        length = self.count(field)
        if length > LONGEST_NAME and length <= self.left:
            raise MeshMessageError(f"{self.scope}{field}: expected at most {LONGEST_NAME} bytes, got {length}")
        start = self.skip(length, 1, 1, field)
        return bytes(self._data[start : start + length]).partition(b"\0")[0].decode("utf-8", "replace")

    def finish(self, field: str, kind: str) -> None:
        """The message must end here.

        Args:
            field: its last field.
            kind: its type.
        """
        if self.left > SLACK:
            raise MeshMessageError(
                f"{field}: {self.left} bytes are left over after the last of them: this is no {kind}"
            )


class Writer:
    """Writes a message of plain CDR, field after field.

    Args:
        little: byte order.
    """

    def __init__(self, little: bool = True) -> None:
        self._order = "<" if little else ">"
        self._data = bytearray(b"\x00\x01\x00\x00" if little else bytes(HEADER))

    def numbers(self, layout: str, size: int, *values: Any) -> None:
        """Consecutive numbers without gaps; arguments as for :meth:`Reader.numbers`."""
        self._align(size)
        self._data += _packing(self._order + layout).pack(*values)

    def text(self, value: str) -> None:
        """A string."""
        encoded = value.encode() + b"\0"
        self.numbers("I", 4, len(encoded))
        self._data += encoded

    def array(self, rows: npt.NDArray[Any], kind: str) -> None:
        """A sequence of the rows of an array, (N, columns), with its count."""
        self.numbers("I", 4, len(rows))
        if len(rows):
            dtype = np.dtype(self._order + kind)
            self._align(dtype.itemsize)
            self._data += memoryview(np.ascontiguousarray(rows, dtype)).cast("B")

    def message(self) -> bytes:
        """What has been written."""
        return bytes(self._data)

    def _align(self, size: int) -> None:
        self._data += bytes((HEADER - len(self._data)) % size)
