# SPDX-License-Identifier: Apache-2.0
"""A way for a robot past everything that it should see, from the surface of the place alone."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Cells = NDArray[np.bool_]
CELL = 0.2  # [m]
TALL = 1.7  # what is higher is passed below [m]
_LEVEL = 0.12  # what is lower is driven over [m]


def drive(centres: Floats, normals: Floats, radius: float, apart: float) -> Floats:
    """(P, 3) places on the floor along a way that comes within about ``apart`` of all where the robot fits.

    Args:
        centres, normals: (N, 3) of small pieces of the surface [m]; up is z.
        radius: of the robot [m].
        apart: distance of places that it must visit [m].

    Raises:
        ValueError: there is no floor, or no room to drive on it.
    """
    flat = normals[:, 2] > 0.9
    if not flat.any():
        raise ValueError("data: there is no floor in the mesh: nothing looks up (z)")
    floor = _level(centres[flat, 2])
    origin = centres[:, :2].min(axis=0) - 2.0 * CELL
    shape = tuple(int(n) for n in np.ceil((centres[:, :2].max(axis=0) - origin) / CELL) + 3)

    def cells(which: NDArray[np.bool_], reach: float) -> Cells:
        """Where one of these pieces is within reach."""
        marked = np.zeros(shape, np.bool_)
        at = ((centres[which, :2] - origin) / CELL).astype(int)
        marked[at[:, 0], at[:, 1]] = True
        return _grown(marked, reach / CELL)

    height = centres[:, 2] - floor
    free = cells(flat & (np.abs(height) < _LEVEL), 2.0 * CELL) & ~cells((height > _LEVEL) & (height < TALL), radius)
    free = _largest(free)
    if free.sum() < 4:
        raise ValueError(f"data: no room for a robot {2 * radius:g} m across on the floor at z = {floor:.2f} m")
    way = [cell for leg in _legs(free, apart / CELL) for cell in leg]
    places = origin + (np.array(way, float) + 0.5) * CELL
    places = _smooth(places)
    return np.column_stack([places, np.full(len(places), floor)])


def _level(heights: Floats) -> float:
    """The height at which most pieces are."""
    step = np.rint(heights / _LEVEL).astype(int)
    steps, counts = np.unique(step, return_counts=True)
    return float(np.median(heights[step == steps[counts.argmax()]]))


def _grown(marked: Cells, reach: float) -> Cells:
    """Cells within so many cells of marked ones."""
    most = int(reach)
    padded, grown = np.pad(marked, most), np.zeros_like(marked)
    for i in range(-most, most + 1):
        for j in range(-most, most + 1):
            if i * i + j * j <= reach * reach:
                grown |= padded[most + i : most + i + marked.shape[0], most + j : most + j + marked.shape[1]]
    return grown


def _steps(free: Cells, start: tuple[int, int]) -> tuple[NDArray[np.int64], dict[tuple[int, int], tuple[int, int]]]:
    """How many steps it is to each free cell, -1 where there is no way, and the cell before on a shortest one."""
    found, before = np.full(free.shape, -1), {}
    found[start] = 0
    queue = deque([start])
    while queue:
        i, j = queue.popleft()
        for a, b in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            cell = i + a, j + b
            if free[cell] and found[cell] < 0 and free[i + a, j] and free[i, j + b]:
                found[cell] = found[i, j] + 1
                before[cell] = i, j
                queue.append(cell)
    return found, before


def _largest(free: Cells) -> Cells:
    """The largest part that hangs together."""
    free[[0, -1]] = free[:, [0, -1]] = False
    left, best = free.copy(), np.zeros_like(free)
    while left.sum() > best.sum():
        i, j = np.argwhere(left)[0]
        part = _steps(left, (int(i), int(j)))[0] >= 0
        best = part if part.sum() > best.sum() else best
        left &= ~part
    return best


def _legs(free: Cells, apart: float) -> list[list[tuple[int, int]]]:
    """Ways from one place to the next, the nearest that has not been visited."""
    cells = np.argwhere(free)
    here = cells[((cells - cells.mean(axis=0)) ** 2).sum(axis=1).argmax()]  # in a corner
    near = np.full(len(cells), np.inf)
    left, last = [], here
    while True:  # the farthest from all that there are
        near = np.minimum(near, np.sqrt(((cells - last) ** 2).sum(axis=1)))
        if near.max() < apart:
            break
        last = cells[near.argmax()]
        left.append((int(last[0]), int(last[1])))
    at, legs = (int(here[0]), int(here[1])), [[(int(here[0]), int(here[1]))]]
    while left:
        steps, before = _steps(free, at)
        goal = min(left, key=lambda cell: (int(steps[cell]), cell))
        left.remove(goal)
        leg, cell = [], goal
        while cell != at:
            leg.append(cell)
            cell = before[cell]
        legs.append(leg[::-1])
        at = goal
    return legs


def _smooth(places: Floats) -> Floats:
    """Corners of the cells cut off; the ends stay."""
    padded = np.concatenate([places[:1], places, places[-1:]])
    return (padded[:-2] + 2.0 * padded[1:-1] + padded[2:]) / 4.0
