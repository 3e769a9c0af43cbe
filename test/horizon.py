# SPDX-License-Identifier: Apache-2.0
"""The sun on terrain by another rule: the horizon of each cell, by brute force over all edges of its triangles, in
float64 and plain numpy. Nothing of the package is used."""

from __future__ import annotations

import numpy as np

LIT, TURNED_AWAY, CAST_SHADOW, UNKNOWN = range(4)


def edges(height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both ends (E, 3) of all edges, as (row, column, height): along rows, along columns, and down to the right."""
    rows, columns = height.shape
    r, c = np.mgrid[0:rows, 0:columns]
    points = np.stack([r, c, height], axis=-1).astype(np.float64)
    pairs = ((points[:, :-1], points[:, 1:]), (points[:-1], points[1:]), (points[:-1, :-1], points[1:, 1:]))
    begin, end = (np.concatenate([pair[k].reshape(-1, 3) for pair in pairs]) for k in (0, 1))
    return begin, end


def horizon(height: np.ndarray, samples: np.ndarray, way: tuple[float, float]) -> np.ndarray:
    """How steeply one must look up to see over a surface.

    Args:
        height: (R, C) of all positions.
        samples: (N, 3) row, column, height.
        way: rows and columns for each metre that one looks along.

    Returns:
        (N,) rise for each metre, -inf where nothing is ahead.
    """
    begin, end = edges(height)
    along = end[:, :2] - begin[:, :2]
    cross = way[0] * along[:, 1] - way[1] * along[:, 0]
    steepest = np.full(len(samples), -np.inf)
    ahead = np.abs(cross) > 1e-12
    begin, end, along, cross = begin[ahead], end[ahead], along[ahead], cross[ahead]
    for n, (row, column, z) in enumerate(samples):
        d = begin[:, :2] - (row, column)
        metres = (d[:, 0] * along[:, 1] - d[:, 1] * along[:, 0]) / cross
        place = (d[:, 0] * way[1] - d[:, 1] * way[0]) / cross
        met = (metres > 1e-6) & (place >= -1e-12) & (place <= 1.0 + 1e-12)
        if met.any():
            over = begin[met, 2] + place[met] * (end[met, 2] - begin[met, 2])
            steepest[n] = ((over - z) / metres[met]).max()
    return steepest


def ringed(z: np.ndarray, missing: float, floor: float, beyond_unknown: bool) -> np.ndarray:
    """(R + 4, C + 4) heights with two rings; those missing, and if it is unknown the inner ring, at one height."""
    outer = np.pad(np.where(np.isnan(z), missing, z), 1, constant_values=missing if beyond_unknown else floor)
    return np.pad(outer, 1, constant_values=floor)


def rise(z: np.ndarray, row: int, column: int, axis: int) -> float:
    """Of the surface from a cell to the next along an axis, NaN if no neighbour is known."""
    known = []
    for step in (-1, 1):
        r, c = (row + step, column) if axis == 0 else (row, column + step)
        inside = 0 <= r < z.shape[0] and 0 <= c < z.shape[1]
        known.append(z[r, c] if inside else np.nan)
    here = z[row, column]
    before, after = known
    if not np.isnan(before) and not np.isnan(after):
        return float((after - before) / 2)
    return float(here - before if np.isnan(after) else after - here)


def codes(
    z: np.ndarray,
    row_step: tuple[float, float],
    column_step: tuple[float, float],
    towards: tuple[float, float, float],
    above: float = 0.0,
    beyond_unknown: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """The code of each cell, and which are too close to call in float64.

    Args:
        z: (R, C) heights, NaN where there is none.
        row_step, column_step: x and y from a row, or column, to the next, at a right angle.
        towards: unit vector to the sun, above the horizon.
        above: of the points over the ground.
        beyond_unknown: whether what is beyond may be as high as the highest height.
    """
    steps = np.array([row_step, column_step])
    squares = (steps**2).sum(axis=1)
    flat = np.hypot(towards[0], towards[1])
    sun = np.array(towards[:2]) / flat
    way = tuple(steps @ sun / squares)
    slope = towards[2] / flat
    floor, ceiling = np.nanmin(z), np.nanmax(z)
    known = np.argwhere(~np.isnan(z))
    samples = np.column_stack([known + 2.0, z[~np.isnan(z)] + above])
    low, high = (horizon(ringed(z, missing, floor, beyond_unknown), samples, way) for missing in (floor, ceiling))
    found, close = np.full(z.shape, UNKNOWN), np.zeros(z.shape, bool)
    for (row, column), at_least, at_most in zip(known, low, high, strict=True):
        close[row, column] = min(abs(at_least - slope), abs(at_most - slope)) < 1e-9
        found[row, column] = CAST_SHADOW if at_least > slope else UNKNOWN if at_most > slope else LIT
        if above == 0.0:
            rises = np.array([rise(z, row, column, axis) for axis in (0, 1)])
            facing = towards[2] - (rises / squares) @ steps @ np.array(towards[:2])
            close[row, column] |= abs(facing) < 1e-9
            if np.isnan(facing):
                found[row, column] = UNKNOWN
            elif facing <= 0.0:
                found[row, column] = TURNED_AWAY
    return found, close
