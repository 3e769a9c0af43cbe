# SPDX-License-Identifier: Apache-2.0
"""Which triangles could a sample's segment to the light meet? Boxes over groups of eight, inflated generously, in
numpy.

Only saves the oracle time on real meshes; `test/test_oracle.py` compares it with no culling at all.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

FAN = 8
SLACK = 1e-9  # of the size of everything; rounding in the box test is a million times smaller


def _morton_order(centres: np.ndarray) -> np.ndarray:
    low, high = centres.min(axis=0), centres.max(axis=0)
    cells = ((centres - low) / np.maximum(high - low, 1e-300).max() * 1023.0).astype(np.int64)
    code = np.zeros(len(centres), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _levels(low: np.ndarray, high: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boxes from the triangles (first) up to a single one (last); the children of node i are 8 i .. 8 i + 7."""
    levels = [(low, high)]
    while len(levels[-1][0]) > 1:
        low, high = levels[-1]
        starts = np.arange(0, len(low), FAN)
        levels.append((np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)))
    return levels


def _touches(start: np.ndarray, step: np.ndarray, end: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Does start + s step, 0 <= s <= end, touch the box? Slab by slab; zero steps are replaced by tiny ones (boxes
    are inflated)."""
    enter, leave = np.zeros(len(start)), np.full(len(start), end)
    for axis in range(3):
        way = np.where(np.abs(step[:, axis]) < 1e-200, 1e-200, step[:, axis])
        one, other = (low[:, axis] - start[:, axis]) / way, (high[:, axis] - start[:, axis]) / way
        enter, leave = np.maximum(enter, np.minimum(one, other)), np.minimum(leave, np.maximum(one, other))
    return enter <= leave


def candidate_pairs(
    points: np.ndarray, light: np.ndarray, w: float, corners: np.ndarray, at_once: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(sample, triangle) index arrays in blocks, a superset of all pairs that can meet. Light homogeneous:
    position, 1 or direction, 0."""
    order = _morton_order((corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0)
    slack = SLACK * max(np.abs(corners - corners[0, 0]).max(), np.abs(points - corners[0, 0]).max())
    a, b, c = (corners[order, k] for k in range(3))
    levels = _levels(np.minimum(np.minimum(a, b), c) - slack, np.maximum(np.maximum(a, b), c) + slack)
    steps = light - w * points
    end = 1.0 + SLACK if w else np.inf
    block = max(1, at_once // 512)
    for first in range(0, len(points), block):
        rays = np.arange(first, min(len(points), first + block))
        nodes = np.zeros(len(rays), np.int64)
        for level, (low, high) in enumerate(reversed(levels)):
            touched = _touches(points[rays], steps[rays], end, low[nodes], high[nodes])
            rays, nodes = rays[touched], nodes[touched]
            if level + 1 < len(levels):
                below = len(levels[len(levels) - 2 - level][0])
                rays = np.repeat(rays, FAN)
                nodes = (nodes[:, None] * FAN + np.arange(FAN)).reshape(-1)
                rays, nodes = rays[nodes < below], nodes[nodes < below]
        yield rays, order[nodes]
