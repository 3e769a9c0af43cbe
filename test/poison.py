# SPDX-License-Identifier: Apache-2.0
"""Memory that nobody has written, made to show: every array that comes uninitialised is filled with a byte of our
choice, when it is allocated and whenever we like."""

from __future__ import annotations

import ctypes
import weakref
from typing import Any

import numpy as np
import pytest
import warp as wp

SMALL = -1
"""Instead of a byte: words from 0 to 2 in random order, which pass for flags, counts and indices."""
BYTES = (0x00, 0x7F, 0xCD, 0xFF, SMALL)
"""Zeros; the largest floats and integers; small negative ones; NaN and -1."""

_WORDS = np.random.default_rng(0).integers(0, 3, 1_000_003, dtype=np.int32)


class Poison:
    """Fills what ``wp.empty``, ``wp.empty_like`` and ``numpy.empty`` return, as long as ``monkeypatch`` holds.

    Args:
        byte: what arrays are filled with when they are allocated.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, byte: int) -> None:
        self.byte = byte
        self._arrays: list[weakref.ref[wp.array]] = []
        for name in ("empty", "empty_like"):
            monkeypatch.setattr(wp, name, self._filling(getattr(wp, name)))
        monkeypatch.setattr(np, "empty", self._filling(np.empty))

    def fill(self, byte: int) -> int:
        """Fill all arrays on the device that are still alive; returns how many bytes those are."""
        alive = [array for known in self._arrays if (array := known()) is not None]
        for array in alive:
            _fill(array, byte)
        return sum(int(array.capacity) for array in alive)

    def _filling(self, allocate: Any) -> Any:
        def filled(*arguments: Any, **named: Any) -> Any:
            array = allocate(*arguments, **named)
            _fill(array, self.byte)
            if isinstance(array, wp.array):
                self._arrays.append(weakref.ref(array))
            return array

        return filled


def _fill(array: Any, byte: int) -> None:
    if isinstance(array, wp.array):
        assert array.device.is_cpu
        if array.ptr:
            _fill_memory(int(array.ptr), int(array.capacity), byte)
    elif not array.dtype.hasobject and array.size:
        _fill_memory(array.ctypes.data, array.nbytes, byte)


def _fill_memory(address: int, size: int, byte: int) -> None:
    if byte != SMALL:
        ctypes.memset(address, byte, size)
        return
    for begin in range(0, size, _WORDS.nbytes):
        ctypes.memmove(address + begin, _WORDS.ctypes.data, min(_WORDS.nbytes, size - begin))
