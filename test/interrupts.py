# SPDX-License-Identifier: Apache-2.0
"""Exceptions that reach the calling thread between two steps of Python, as those of Ctrl-C and of signal handlers do.

Two ways: at a step of our choice, counted by a profiler, which is the same in every run; and by a timer's signal,
whose moment is random, but which also arrives while the thread waits for others.
"""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


class Ring(BaseException):
    """What a handler raises: like KeyboardInterrupt no Exception."""


class Steps:
    """Calls a function and raises :class:`Ring` at one of the steps at which a signal could arrive, in whatever Python
    function that is: where a function begins, and where a call of one written in C has ended."""

    def __init__(self) -> None:
        self.taken = 0
        self.at = 0

    def count(self, function: Callable[[], Any]) -> int:
        """How many steps ``function`` takes."""
        self.run(function, 0)
        return self.taken

    def run(self, function: Callable[[], Any], at: int) -> Any:
        """What ``function`` returns; raises at step number ``at``, 1 being the first; 0: never.

        Where it would be lost, in a ``__del__`` or a weak reference's callback, it is raised again at the next step.
        """
        self.taken, self.at = 0, at
        profile, hook, collects = sys.getprofile(), sys.unraisablehook, gc.isenabled()

        def lost(unraisable: Any) -> None:
            if unraisable.exc_type is not Ring:
                hook(unraisable)
                return
            # Python takes a profiler that raised away.
            self.at = self.taken + 1
            sys.setprofile(self._step)

        # Collections come when the whole process has allocated enough, so their callbacks are not the function's steps.
        gc.disable()
        sys.unraisablehook = lost
        sys.setprofile(self._step)
        try:
            return function()
        finally:
            sys.setprofile(profile)
            sys.unraisablehook = hook
            if collects:
                gc.enable()

    def _step(self, frame: FrameType, event: str, argument: Any) -> None:
        # Our own call at the end is no step.
        if event in ("call", "c_return") and argument is not sys.setprofile:
            self.taken += 1
            if self.taken == self.at:
                raise Ring


def ring_after(seconds: float, function: Callable[[], Any]) -> bool:
    """Call ``function`` with a timer set: its signal raises :class:`Ring` wherever the main thread is then. Returns
    whether it came before the function had ended."""

    def ring(number: int, frame: Any) -> None:
        raise Ring

    before = signal.signal(signal.SIGALRM, ring)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            function()
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        except Ring:
            return True
        return False
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
