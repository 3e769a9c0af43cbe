# SPDX-License-Identifier: Apache-2.0
"""Leaves out frames where a machine is too slow for all of them."""

from __future__ import annotations

import math

LARGEST_STEP = 4


class Pace:
    """Chooses the next frame so that a sequence is played within a budget of time.

    Args:
        frames: number of frames to be played.
        budget: seconds for all of them, counted from the first answer; 0 plays every frame however long it takes.
    """

    def __init__(self, frames: int, budget: float) -> None:
        self._frames = frames
        self._budget = budget
        self._answers = 0
        self._first = self._last = 0.0

    def answered(self, now: float) -> None:
        """Notes the answer to a frame at the steady time `now` [s]."""
        if self._answers == 0:
            self._first = now
        self._answers += 1
        self._last = now

    def after(self, index: int) -> int:
        """The frame to play after frame `index`: the next one, or one up to four further on if time runs short.

        A round stays evenly spaced as far as can be: of the steps that suffice the smallest is taken. What follows the
        round is played in any case.
        """
        return min(self._after(index), self._frames) if index < self._frames else index + 1

    def _after(self, index: int) -> int:
        if self._budget <= 0 or self._answers < 3:
            return index + 1
        spent = self._last - self._first
        each = spent / (self._answers - 1)
        left = max(self._budget - spent, each)
        needed = math.ceil((self._frames - 1 - index) * each / left)
        return index + min(max(needed, 1), LARGEST_STEP)
