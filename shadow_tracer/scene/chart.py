# SPDX-License-Identifier: Apache-2.0
"""Whether a surface is a height field: a projective map that takes its positions to (column, row, height).

Two kinds of surfaces are: the *parallel* kind, heights along one of the axes x, y, z over a regular grid in the plane
of the other two (terrain), and the *central* kind, positions along the rays of a pinhole camera in the origin that
looks along z, whose height is 1/z (a depth image). Either map takes lines to lines and planes to planes.

It is found by a fit, or follows from the camera where the surface is that of a depth image. Nothing is right or wrong
because of it: what a pipeline makes of it is measured once more on the device, and a surface that has no chart is a
mesh like any other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.depth_mesh import depth_range
from shadow_tracer.scene.parts import DepthSurface

STEPS = 65535.0
"""Heights within a chart go from 0 to this."""
_SAMPLES = 64  # rows and columns that the fit looks at, or a few more
_BESIDE = 1.0 / 16.0  # cells that a position may be away from its place
# The least span of heights, of the surface's width in the parallel kind, of the largest 1/z in the central kind: so
# that no step is so small that roundings would matter.
_LEAST_SPAN = 2.0**-12


@dataclass(frozen=True)
class Chart:
    """A projective map from a surface's frame.

    Attributes:
        rows: (4, 4) S, T, H and D over ((x, y, z) - center, 1): column S/D, row T/D and height H/D, 0 to ``STEPS``.
        nearest: the least D of any position, above 0; 1 of the parallel kind, whose D is 1.
        parallel: of which kind it is.
        center: (3,) the middle of the positions [m].
        extent: how far they are from there along an axis at most [m].
    """

    rows: FloatArray
    nearest: float
    parallel: bool
    center: FloatArray
    extent: float


def find_chart(vertices: FloatArray, grid: tuple[int, int]) -> Chart | None:
    """The chart of a surface, or None if it has none.

    Args:
        vertices: (R * C, 3) row by row, NaN where there is none.
        grid: R and C.
    """
    if min(grid) < 2:
        return None
    points = vertices.reshape(*grid, 3)
    with np.errstate(all="ignore"):
        low, high = (np.array([reduce(points[..., k], axis=None) for k in range(3)]) for reduce in _EXTREMES)
        if not np.isfinite(low).all():
            return None
        center = 0.5 * low + 0.5 * high
        extent = max(float((high - center).max()), 1e-30)
        return _parallel(points, center, extent) or _central(points, center, extent, float(low[2]), float(high[2]))


def depth_chart(surface: DepthSurface) -> Chart | None:
    """The chart of a depth image's surface, without asking for its vertices; None if it has none: no pixel is measured,
    or the camera has a table of rays."""
    camera, step = surface.camera, surface.step
    near, far = depth_range(surface.image, step)
    if camera.rays is not None or min(surface.corners) < 2 or not far > 0.0:
        return None
    low, high = surface.box()
    low[2] = near
    center = 0.5 * low + 0.5 * high
    extent = max(float((high - center).max()), 1e-30)
    found = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy]]) / step
    with np.errstate(all="ignore"):
        chart = _over_rays(found, center, extent, near, far)
    return chart if np.isfinite(chart.rows).all() else None


_EXTREMES = np.fmin.reduce, np.fmax.reduce  # of what is not NaN


def _parallel(points: FloatArray, center: FloatArray, extent: float) -> Chart | None:
    for axis in (2, 0, 1):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        found = _fit(points[..., first] - center[first], points[..., second] - center[second])
        if found is None:
            continue
        rows = np.zeros((4, 4))
        rows[:2, [first, second, 3]] = found
        height = points[..., axis] - center[axis]
        low, high = (float(reduce(height, axis=None)) for reduce in _EXTREMES)
        rows[2], rows[3, 3] = _heights(np.eye(4)[axis], np.eye(4)[3], low, high, _LEAST_SPAN * extent), 1.0
        return Chart(rows, 1.0, True, center, extent)
    return None


def _central(points: FloatArray, center: FloatArray, extent: float, low: float, high: float) -> Chart | None:
    if not low > 0.0:
        return None
    found = _fit(points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
    return None if found is None else _over_rays(found, center, extent, low, high)


def _over_rays(found: FloatArray, center: FloatArray, extent: float, low: float, high: float) -> Chart:
    """The chart of what is between two depths, with the affine map from (x/z, y/z, 1) to column and row."""
    rows = np.zeros((4, 4))
    rows[:2, :3] = found
    rows[3, 2] = 1.0
    rows[:, 3] = rows[:, :3] @ center
    rows[2] = _heights(np.eye(4)[3], rows[3], 1.0 / high, 1.0 / low, _LEAST_SPAN / low)
    return Chart(rows, low * (1.0 - 1e-9), False, center, extent)


def _heights(height: FloatArray, one: FloatArray, low: float, high: float, least: float) -> FloatArray:
    """The row H that takes low and high, or what lies around them if they are too near, to a little within 0 and
    ``STEPS``."""
    middle, half = 0.5 * low + 0.5 * high, max(0.5 * high - 0.5 * low, 0.5 * least) * (1.0 + 1e-6)
    scale: float = 0.5 * STEPS / half
    row: FloatArray = scale * height + (0.5 * STEPS - scale * middle) * one
    return row


def _fit(x: FloatArray, y: FloatArray) -> FloatArray | None:
    """(2, 3) affine map from (x, y, 1) to column and row, None if none serves all that are numbers."""
    rows, columns = x.shape
    down, across = np.arange(rows)[:, None], np.arange(columns)[None]
    some = slice(None, None, 1 + rows // _SAMPLES), slice(None, None, 1 + columns // _SAMPLES)
    there = np.isfinite(x[some])
    places = [np.broadcast_to(each, x.shape)[some][there] for each in (across, down)]
    if not there.any():
        return None
    known, plane = np.stack(places, axis=-1), np.stack([x[some][there], y[some][there]], axis=-1)
    middle, at = known.mean(axis=0), plane.mean(axis=0)
    try:
        to_plane, _, rank, _ = np.linalg.lstsq(known - middle, plane - at, rcond=None)
    except np.linalg.LinAlgError:  # numbers that it cannot calculate with
        return None
    if rank < 2:
        return None
    forward = to_plane.T
    if not abs(np.linalg.det(forward)) > 1e-6 * float(np.linalg.norm(forward)) ** 2:
        return None
    back = np.linalg.inv(forward)
    found = np.column_stack([back, middle - back @ at])
    for part in (some, (slice(None), slice(None))):  # a look at some rules most out
        for k, wanted in enumerate((across, down)):
            off = found[k, 0] * x[part] + (found[k, 1] * y[part] + found[k, 2])
            off -= np.broadcast_to(wanted, x.shape)[part]
            if not max(-float(np.fmin.reduce(off, axis=None)), float(np.fmax.reduce(off, axis=None))) <= _BESIDE:
                return None
    return found if np.isfinite(found).all() else None
