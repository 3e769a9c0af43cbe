# SPDX-License-Identifier: Apache-2.0
"""Bands of the samples of a frame: how many, and where they begin. No Warp here.

A frame is done when its slowest band is. Equal numbers of measurements are not equal work: one half of an image may
look into the sky. So bands of an image are cut where those of the frames before have taken equally long, in time of the
processor: how long a thread has waited for one says nothing of its rows. The answer does not depend on where the cuts
are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.device import forms
from shadow_tracer.scene.bounds import Bounds

_Names = TypeVar("_Names")
_Row = npt.NDArray[np.float64]

# Fewer samples for each band are not worth a thread.
LEAST = 16384
_WORTH = 0.04  # of a frame's time: cuts are not moved for less, as some of what is kept is made again for others
_QUICK = 2  # moves after one frame each, to begin with
_FRAMES = 4  # frames of which the median counts for all further moves
_ELSEWHERE = 0.004  # parts of all measurements: cuts that differ less are at the same row, of another image
_FARTHEST = 0.3  # parts of an even band that a cut is moved at once, should a time have been an accident


def band_count(device: Any, bounds: Bounds, threads: int, graphs: bool) -> int:
    """How many bands of the rays there are to be."""
    if not forms.wide(device) or graphs or bounds.max_rays < LEAST * threads:
        return 1
    return threads


def even_bands(count: int, bands: int) -> list[tuple[int, int]]:
    """First and end of each band of ``count`` samples."""
    ends = [count * number // bands for number in range(bands + 1)]
    return list(zip(ends[:-1], ends[1:], strict=True))


def image_bands(depth: np.ndarray, at: Sequence[float], room: int) -> tuple[list[tuple[int, int]], list[float]]:
    """First pixel and end of each band: bands of the image.

    Args:
        at: where to cut, in parts of all measurements from the top, ascending.
        room: the most pixels of a band; all bands together hold the image.

    Returns:
        The bands, and where the cuts really are: at rows, and no band has more pixels than there is room for.
    """
    size, width, bands = depth.size, depth.shape[1], len(at) + 1
    if bands == 1:
        return [(0, size)], []
    step = max(1, min(depth.shape) // 64)
    seen = depth[::step, ::step]
    measured = np.cumsum([0.0, *((seen > 0) & np.isfinite(seen)).sum(axis=1) + 0.1 * seen.shape[1]])
    rows = np.searchsorted(0.5 * (measured[1:] + measured[:-1]), measured[-1] * np.asarray(at))
    rows = np.clip(rows, 1, max(1, len(seen) - 1)) * step  # the first and the last band have some, if there are rows
    ends = [0]
    for number, row in enumerate(rows, start=1):
        # Neither this band nor those that follow may get more than they have room for.
        end = min(max(min(int(row) * width, ends[-1] + room), size - (bands - number) * room, ends[-1]), size)
        ends.append(end)
    ends.append(size)
    above = np.interp([end / width / step for end in ends[1:-1]], np.arange(len(measured)), measured)
    return list(zip(ends[:-1], ends[1:], strict=True)), [float(part) for part in above / measured[-1]]


class Balance:
    """Where the images of a camera are cut.

    Args:
        bands: how many bands there are.
    """

    def __init__(self, bands: int) -> None:
        self._count = bands
        self._wanted = np.arange(1, bands) / bands
        self._edges: list[float] = []
        self._times: list[list[float]] = []
        self._last: tuple[_Row, _Row] | None = None  # cuts, and which part of the work lay above each
        self._before: tuple[_Row, _Row] | None = None  # the same of other cuts
        self._moves = 0

    def cut(self, depth: np.ndarray, room: int) -> list[tuple[int, int]]:
        """First pixel and end of each band of a depth image, none with more than ``room`` pixels."""
        cuts, self._edges = image_bands(depth, list(self._wanted), room)
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
        done = np.cumsum(took[:-1]) / took.sum()
        ideal = np.interp(np.arange(1, self._count) / self._count, *self._work(np.asarray(self._edges), done))
        farthest = _FARTHEST / self._count
        self._wanted = np.clip(ideal, np.asarray(self._edges) - farthest, np.asarray(self._edges) + farthest)
        self._moves += 1

    def _work(self, edges: _Row, done: _Row) -> tuple[_Row, _Row]:
        """Which parts of the work lie above where, ascending, as if it were spread evenly in between: those of the cuts
        that have been tried now, and of the last ones that were others. By one cut alone the next jumps to and fro over
        a few rows that have much of the work."""
        if self._last is not None and np.abs(self._last[0] - edges).max() > _ELSEWHERE:
            self._before = self._last
        self._last, before = (edges, done), self._before
        if before is None:
            return np.r_[0.0, done, 1.0], np.r_[0.0, edges, 1.0]
        # What was found before may be of another image: what has been found now holds.
        place = np.searchsorted(edges, before[0])
        above = np.clip(before[1], np.r_[0.0, done][place], np.r_[done, 1.0][place])
        at, first = np.unique(np.r_[0.0, edges, 1.0, before[0]], return_index=True)
        return np.r_[0.0, done, 1.0, above][first], at


def balances(bands_of: Mapping[_Names, Sequence[Any]]) -> dict[_Names, Balance]:
    """Of each pipeline that has several bands one that has learned nothing yet."""
    return {names: Balance(len(bands)) for names, bands in bands_of.items() if len(bands) > 1}
