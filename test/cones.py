# SPDX-License-Identifier: Apache-2.0
"""What is so of cones, found by other means than the package's: convex minimisation, dense sampling, rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

Function = Callable[[np.ndarray], np.ndarray]


def unit(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) of length one."""
    lengths: np.ndarray = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return vectors / lengths


def parts(points: np.ndarray, apex: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far along a unit axis points (..., 3) are, and how far from it."""
    from_apex = points - apex
    along = (from_apex * axis).sum(axis=-1)
    beside = from_apex - along[..., None] * axis
    return along, np.sqrt((beside * beside).sum(axis=-1))


def _least(function: Function, low: np.ndarray, high: np.ndarray, steps: int) -> np.ndarray:
    """The least value of convex functions between ``low`` and ``high``, by thirds."""
    for _ in range(steps):
        one, two = low + (high - low) / 3, high - (high - low) / 3
        left = function(one) < function(two)
        low, high = np.where(left, low, one), np.where(left, two, high)
    return function(0.5 * (low + high))


def least(corners: np.ndarray, function: Function, steps: int = 32) -> np.ndarray:
    """(N,) the least value that a convex function of points (N, 3) has in triangles (N, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    zero, one = np.zeros(len(corners)), np.ones(len(corners))

    def along(share: np.ndarray) -> np.ndarray:
        return _least(lambda other: function(a + share[:, None] * (b - a + other[:, None] * (c - b))), zero, one, steps)

    return _least(along, zero, one, steps)


def excess(corners: np.ndarray, apex: np.ndarray, end: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(N,) by how much triangles (N, 3, 3) are outside of cones with apices, ends (N, 3) and slopes (N,): below zero
    they meet."""
    way = end - apex
    length, axis = np.sqrt((way * way).sum(axis=-1)), unit(way)

    def outside(points: np.ndarray) -> np.ndarray:
        along, beside = parts(points, apex, axis)
        return np.maximum(beside - slope * along, along - length)

    return least(corners, outside)


def entry(corners: np.ndarray, apex: np.ndarray, axis: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """(N,) how far along their unit axes (N, 3) triangles (N, 3, 3) enter endless cones, infinite where they do not:
    about, as the mantle is a steep wall here."""

    def outside(points: np.ndarray) -> np.ndarray:
        along, beside = parts(points, apex, axis)
        return beside - slope * along

    def walled(points: np.ndarray) -> np.ndarray:
        return parts(points, apex, axis)[0] + 1e4 * np.maximum(outside(points), 0.0)

    return np.where(least(corners, outside) < 0.0, least(corners, walled), np.inf)


def ends_of_rays(apex: np.ndarray, end: np.ndarray, radius: np.ndarray, count: int) -> np.ndarray:
    """(N, count, 3) points of the ends of N cones, half of them at the rim, a 1e-9th of the radius inside."""
    axis = unit(end - apex)
    other = np.where(np.abs(axis[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    right = unit(np.cross(axis, other))
    up = np.cross(axis, right)
    number = np.arange(count)
    share = np.where(number < count // 2, np.sqrt((number + 0.5) / count), 1.0) * (1.0 - 1e-9)
    turn = 2.399963 * number
    beside = (share * np.cos(turn))[:, None] * right[:, None] + (share * np.sin(turn))[:, None] * up[:, None]
    ends: np.ndarray = end[:, None] + radius[:, None, None] * beside
    return ends


def some(rng: np.random.Generator, count: int, low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """Ends (count, 3) in a box, and shares of the length (count,) for radii, from slivers to wide ones."""
    return rng.uniform(low, high, (count, 3)), 10.0 ** rng.uniform(-4.0, 0.3, count)
