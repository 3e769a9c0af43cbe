# SPDX-License-Identifier: Apache-2.0
"""States of samples as they come from a GPU: two bits each, in planes of which masks are made directly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]


def as_bytes(found: PackedStates | Bytes) -> Bytes:
    """(L, N) states, a byte each, whichever way they came."""
    return found.bytes if isinstance(found, PackedStates) else found


def words_of(count: int) -> int:
    """Words of 32 bits that a plane of ``count`` samples takes."""
    return -(-count // 32)


class PackedStates:
    """States 0 (lit) to 3 (invalid) of ``count`` samples for some lights.

    Args:
        planes: (L, 2, words) uint32, for each light the plane of the states' low bits and that of their high bits; bit
            i modulo 32 of word i // 32 is sample i.
    """

    def __init__(self, planes: npt.NDArray[np.uint32], count: int) -> None:
        self._planes = planes
        self._count = count
        self._bytes: Bytes | None = None

    @property
    def bytes(self) -> Bytes:
        """(L, N) states, a byte each."""
        if self._bytes is None:
            low, high = self._unpacked(self._planes[:, 0]), self._unpacked(self._planes[:, 1])
            high += high
            high += low
            self._bytes = high
        return self._bytes

    def lit(self, light: int) -> Bytes:
        """(N,) 1 where ``light`` reaches, else 0."""
        return self._unpacked(self._lit(light))

    def lit_by_any(self) -> Bytes:
        """(N,) 1 where some light reaches, else 0."""
        return self._unpacked(np.bitwise_or.reduce(self._lit(slice(None)), axis=0))

    def invalid(self) -> npt.NDArray[np.bool_]:
        """(N,) where there is no sample, which is the same for all lights."""
        return self._unpacked(self._planes[0, 0] & self._planes[0, 1]).view(np.bool_)

    def _lit(self, light: int | slice) -> npt.NDArray[np.uint32]:
        lit: npt.NDArray[np.uint32] = ~(self._planes[light, ..., 0, :] | self._planes[light, ..., 1, :])
        return lit

    def _unpacked(self, planes: npt.NDArray[np.uint32]) -> Bytes:
        # Words are little-endian on every machine that Warp runs on.
        octets = np.ascontiguousarray(planes).view(np.uint8)
        return np.unpackbits(octets, axis=-1, count=self._count, bitorder="little")
