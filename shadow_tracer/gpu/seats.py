# SPDX-License-Identifier: Apache-2.0
"""One frame at a time for each owner of device buffers, and nothing else on a device while a frame is recorded.

While a device records, whatever any thread launches on it goes into the recording instead of being executed. So a frame
that may be recorded holds the locks of all owners on its device, one that may not be only that of its own.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

_Result = TypeVar("_Result")


class _Room:
    """The seats on one device."""

    def __init__(self) -> None:
        self.recording = threading.RLock()  # held by whoever takes several locks: nobody else may
        self.seats: list[weakref.ref[Seat]] = []

    def enter(self, seat: Seat) -> None:
        with self.recording:  # not in the middle of a recording
            self.seats = [known for known in self.seats if known() is not None] + [weakref.ref(seat)]

    def locks(self) -> list[Any]:
        return [seat.lock for known in self.seats if (seat := known()) is not None]


_rooms: dict[str, _Room] = {}


class Seat:
    """The right of one tracer or depth camera to work on a device.

    Args:
        device: a Warp device.
        records: whether its frames may be recorded.
    """

    def __init__(self, device: Any, records: bool) -> None:
        self.lock: Any = threading.RLock()
        self._cuda = bool(device.is_cuda)
        self._records = records
        self._process = os.getpid()
        self._room = _rooms.setdefault(str(device), _Room())
        self._room.enter(self)

    def run(self, frame: Callable[[], _Result]) -> _Result:
        """Do ``frame`` while nobody else does one here, nor, if frames may be recorded, on the whole device.

        Raises:
            RuntimeError: called from within a frame of the same owner, for instance by a signal handler; or in a child
                process that was forked after a GPU was used.
        """
        if self._cuda and self._process != os.getpid():
            raise RuntimeError(
                "device: a GPU that was used before os.fork cannot be used in the child process; start processes by "
                "multiprocessing.get_context('spawn')"
            )
        if self.lock._is_owned():
            raise RuntimeError("a frame is under way in this thread: it cannot begin another one before it has ended")
        if not self._records:
            with self.lock:
                return frame()
        with self._room.recording:
            return _holding(self._room.locks(), frame)


def _holding(locks: Sequence[Any], frame: Callable[[], _Result]) -> _Result:
    """Do ``frame`` with all locks held. By recursion: an exception between two steps of an ``ExitStack`` would leave a
    lock that is never released."""
    if not locks:
        return frame()
    with locks[0]:
        return _holding(locks[1:], frame)


def _after_fork() -> None:
    """In the child nobody will release what other threads of the parent held."""
    for room in _rooms.values():
        room.recording = threading.RLock()
        for known in room.seats:
            seat = known()
            if seat is not None:
                seat.lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
