# SPDX-License-Identifier: Apache-2.0
"""Between host and device: arrays and structs up, results down. On the CPU both are the same memory.

CUDA copies by itself only from and to pinned memory; anything else keeps the host waiting. So arrays go up through a
ring of pinned pieces, structs have a pinned twin, and results come down into pinned copies, for all of which the host
waits once, when there is nothing left to do.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any
from weakref import ref

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.views import Views

_PIECE = 1 << 20  # bytes: 40 us of a bus with 25 GB/s, much longer than it takes to start a copy
_PLACES = 4


class Uploads:
    """Copies numpy arrays to a device. Only for use by one thread if they are staged, and outside of recordings.

    The device fetches a piece while the host copies the next one into the ring, and works while the host copies another
    array: it waits for nothing but what it is to read, and the host only for a place in the ring.

    Args:
        staged: whether pieces go through the ring; None: if the device is a GPU.
    """

    def __init__(self, device: Any, piece: int = _PIECE, places: int = _PLACES, staged: bool | None = None) -> None:
        self._device = device
        self._piece, self._places = piece, places
        self._staged = not forms.wide(device) if staged is None else staged
        self._ring: wp.array | None = None  # made when first needed
        self._typed: dict[tuple[int, Any], wp.array] = {}
        self._fetched: list[wp.Event | None] = [None] * places
        self._next = 0

    def __call__(self, destination: wp.array, source: npt.NDArray[Any], offset: int = 0) -> None:
        """Copy ``source`` (C-contiguous, elements of ``destination``'s dtype) into ``destination`` from element
        ``offset`` on. ``source`` may be changed right afterwards."""
        count = len(source)
        if count == 0:
            return
        if not self._staged:
            destination.numpy()[offset : offset + count] = source
            return
        size = destination.strides[0]
        read = source.reshape(-1).view(np.uint8)
        if read.size != count * size:
            raise ValueError(f"source: expected {count} elements of {size} bytes, got {read.size} bytes")
        for first in range(0, count, self._piece // size):
            many = min(self._piece // size, count - first)
            staging = self._free_place(destination.dtype)
            held = np.ctypeslib.as_array((ctypes.c_uint8 * (many * size)).from_address(int(staging.ptr or 0)))
            held[:] = read[first * size : (first + many) * size]
            wp.copy(destination, staging, dest_offset=offset + first, count=many)
            self._close_place()

    def _free_place(self, dtype: Any) -> wp.array:
        """The next place of the ring, from which the device has fetched all that it has been told to."""
        if self._ring is None:
            pinned = self._device.is_cuda
            self._ring = wp.empty(self._places * self._piece, dtype=wp.uint8, device="cpu", pinned=pinned)
        event = self._fetched[self._next]
        if event is not None:
            wp.synchronize_event(event)
        key = (self._next, dtype)
        if key not in self._typed:
            begin = int(self._ring.ptr or 0) + self._next * self._piece
            shape = (self._piece // wp.types.type_size_in_bytes(dtype),)
            self._typed[key] = wp.array(ptr=begin, dtype=dtype, shape=shape, device="cpu", pinned=self._ring.pinned)
        return self._typed[key]

    def _close_place(self) -> None:
        """A copy from the next place has been started; go on to the one after it."""
        if self._device.is_cuda:
            event = self._fetched[self._next] or wp.Event(self._device)
            self._fetched[self._next] = wp.get_stream(self._device).record_event(event)
        self._next = (self._next + 1) % self._places


class HostValues:
    """A few structs that the host writes and kernels read: from memory and not as arguments, so that recorded launches
    see new values."""

    def __init__(self, dtype: Any, capacity: int, device: Any) -> None:
        self.array = wp.zeros(capacity, dtype=dtype, device=device)
        self.staging = self.array if device.is_cpu else wp.zeros(capacity, dtype=dtype, device="cpu", pinned=True)
        self._records = self.staging.numpy()

    def write(self, values: Sequence[Any]) -> None:
        """Make the first elements of ``array`` equal to ``values``."""
        # The bytes as they are: through a numpy value, Warp's other way, a struct takes twenty times longer.
        begin, size = int(self.staging.ptr or 0), self.staging.strides[0]
        for index, value in enumerate(values):
            ctypes.memmove(begin + index * size, ctypes.byref(value.__ctype__()), size)
        self._send(len(values))

    def put(self, records: npt.NDArray[Any]) -> None:
        """The same for values of numpy, whose fields are those of the structs."""
        self._records[: len(records)] = records
        self._send(len(records))

    def _send(self, count: int) -> None:
        if self.staging is not self.array:
            wp.copy(self.array, self.staging, count=count)


class HostCopies:
    """What the host reads of arrays on the device: all of it is on its way before the host waits, once.

    Args:
        mirrored: whether they are copied; otherwise the arrays themselves are read, which on a GPU is a wait for each.
    """

    def __init__(self, device: Any, mirrored: bool) -> None:
        self._device = device
        self._mirrored = mirrored
        # By where an array is: it, its copy, and whether that is fetched in full.
        self._copies: dict[int, tuple[ref[wp.array], wp.array, bool]] = {}
        self._asked: wp.Event | None = None
        self._views = Views()

    def add(self, array: wp.array, whole: bool = True) -> wp.array:
        """Have room for a copy of ``array``, which is returned; ``whole``: fetched in full each time. Both as long as
        somebody has the array."""
        if self._mirrored:
            copies, place = self._copies, int(array.ptr or 0)

            def end(gone: ref[wp.array]) -> None:
                if place in copies and copies[place][0] is gone:
                    del copies[place]

            mirror = wp.zeros(array.shape, dtype=array.dtype, device="cpu", pinned=self._device.is_cuda)
            copies[place] = ref(array, end), mirror, whole
        return array

    def fetch(self, array: wp.array, count: int) -> None:
        """Copy all arrays that are fetched in full, and the first ``count`` elements, at least one, of another one;
        wait for the device."""
        if not self._mirrored:
            return
        for known, mirror, whole in list(self._copies.values()):
            each = known() if whole else None
            if each is not None:
                wp.copy(mirror, each)
        wp.copy(self._copies[int(array.ptr or 0)][1], array, count=count)
        if self._device.is_cuda:
            self._asked = wp.get_stream(self._device).record_event(self._asked or wp.Event(self._device))
            wp.synchronize_event(self._asked)

    def read(self, array: wp.array) -> npt.NDArray[Any]:
        """The array as it was when last fetched; overwritten when that happens again."""
        copy = self._copies.get(int(array.ptr or 0))
        if copy is not None:
            array = copy[1]
        return self._views(array)
