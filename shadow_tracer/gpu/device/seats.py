# SPDX-License-Identifier: Apache-2.0
"""One frame at a time for each owner of device buffers, and nothing else on a device while it records or loads.

While a device records, whatever any thread launches on it goes into the recording instead of being executed; and while
a thread loads kernels, another one that loads or runs the same ones may lose them. So a frame that may be recorded, or
needs kernels that nobody has launched yet, holds the locks of all owners on its device; any other one only its own.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.kernel_cache import mending

_Result = TypeVar("_Result")


class _Room:
    """The seats on one device."""

    def __init__(self) -> None:
        self.several = threading.RLock()  # held by whoever takes several locks: nobody else may
        self.loaded: dict[bool, set[Hashable]] = {True: set(), False: set()}  # by whether in the wide form
        self.seats: list[weakref.ref[Seat]] = []

    def enter(self, seat: Seat) -> None:
        with self.several:  # not while somebody is alone here
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
        self._loaded = self._room.loaded[forms.wide(device)]

    @property
    def loaded(self) -> set[Hashable]:
        """Which kernels of the same form have been launched on the device by anybody, in the words of those who launch
        them."""
        return self._loaded

    def run(self, frame: Callable[[], _Result], needs: Sequence[Hashable] = ()) -> _Result:
        """Do ``frame`` while nobody else does one here, nor on the whole device if it may be recorded or loads kernels.

        Args:
            frame: done again from its start if a module of kernels had to be compiled again (:mod:`kernel_cache`).
            needs: kernels that it launches; it has to add them to ``loaded``.

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
        if not self._records and self._loaded.issuperset(needs):
            with self.lock:
                return mending(frame)
        with self._room.several:
            return _holding(self._room.locks(), lambda: mending(frame))


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
        room.several = threading.RLock()
        for known in room.seats:
            seat = known()
            if seat is not None:
                seat.lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
