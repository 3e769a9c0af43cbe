# SPDX-License-Identifier: Apache-2.0
"""Bands of the image that take equally long, learned from what those of the frames before took. No Warp here.

A frame is done when its slowest share is. Equal numbers of measurements are not equal work: one half of an image may
look into the sky. The answer does not depend on where the cuts are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shadow_tracer.gpu.engine.cuts import image_cuts

_WORTH = 0.04  # of a frame's time: cuts are not moved for less, as some of what is kept is made anew for others
_QUICK = 2  # moves after one frame each, to begin with
_FRAMES = 4  # frames of which the median counts for all further moves
_FARTHEST = 0.3  # parts of an even share that a cut is moved at once, should a time have been an accident


class Balance:
    """Where the images of a camera are cut.

    Args:
        shares: how many bands there are.
    """

    def __init__(self, shares: int) -> None:
        self._shares = shares
        self._wanted = np.arange(1, shares) / shares
        self._edges: list[float] = []
        self._times: list[list[float]] = []
        self._moves = 0

    def cut(self, depth: np.ndarray, room: int) -> list[tuple[int, int]]:
        """First pixel and end of each band of a depth image, none with more than ``room`` pixels."""
        cuts, self._edges = image_cuts(depth, list(self._wanted), room)
        return cuts

    def learn(self, times: Sequence[float]) -> None:
        """Tell how long each band of the image that was cut last has taken, 0 if it has no pixels."""
        self._times.append(list(times))
        if len(self._times) < (1 if self._moves < _QUICK else _FRAMES):
            return
        took = np.median(self._times, axis=0)
        self._times = []
        if took.max() <= (1.0 + _WORTH) * took.mean():
            return
        # As if the work of each band were spread evenly over it.
        done = np.cumsum([0.0, *took]) / took.sum()
        ideal = np.interp(np.arange(1, self._shares) / self._shares, done, [0.0, *self._edges, 1.0])
        farthest = _FARTHEST / self._shares
        self._wanted = np.clip(ideal, np.asarray(self._edges) - farthest, np.asarray(self._edges) + farthest)
        self._moves += 1
