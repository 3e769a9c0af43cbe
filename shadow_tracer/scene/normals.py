# SPDX-License-Identifier: Apache-2.0
"""Normals of the surface in a depth image, and the samples that a bias moves along them.

On a plane inverse depth is a linear function of the point (x, y) where a pixel's ray meets z = 1. So the normal of a
pixel is the slope of a plane fitted to nine inverse depths: its own, and those of eight neighbours about a hundredth of
the distance away (five pixels at a focal length of 525). Noise needs neighbours that far; a slope that is off by ten
degrees moves a sample off its surface nearly as well as the right one. Neighbours with another depth by more than a
twentieth belong to something else and do not count, nor do those without a ray. Where those that do lie on a line there
is no normal: on things narrower than that, at steps, beside pixels without depth.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.camera import Camera, RayTable
from shadow_tracer.scene.checks import LARGEST, FloatArray, unmasked_depth

LARGEST_JUMP = 0.05  # relative, of inverse depth
FLATTEST = 0.01  # what det / (mxx myy) of the fit must exceed: 0 is neighbours on a line, 1 all of them
MEASURED = (1e-30, 1e30)  # depths that float32 can turn over
_REACH = 0.01  # of the distance
_MOST_PIXELS = 32767.0

Sums = tuple[FloatArray, ...]


def neighbours(focal: float) -> tuple[int, float]:
    """How many pixels away the neighbours are, and how far apart their rays at z = 1, a float32 number."""
    step = max(1, round(min(_REACH * focal, _MOST_PIXELS)))
    with np.errstate(over="ignore"):
        return step, float(np.float32(step / focal))


def focal_lengths(camera: Camera) -> tuple[float, float]:
    """Pixels per unit of x and y at z = 1 [px]; with a table of rays those of the median pixel, 1 if it has no two."""
    return (camera.fx, camera.fy) if camera.rays is None else _median_focal_lengths(camera.rays)


@lru_cache(maxsize=8)
def _median_focal_lengths(rays: RayTable) -> tuple[float, float]:
    apart = [np.abs(np.diff(rays.xy[..., axis], axis=1 - axis)).astype(np.float64) for axis in (0, 1)]
    known = [each[each > 0.0] for each in apart]
    x, y = (1.0 / float(np.median(each)) if each.size else 1.0 for each in known)
    return x, y


def depth_normals(depth: Any, camera: Camera) -> FloatArray:
    """Unit normals of the surface at each pixel of a depth image.

    Computed in the same order of operations as on the device.

    Args:
        depth: (H, W) float32 metres (zero, negative and non-finite values are no measurement) or uint16 millimetres
            (0 is none); masked pixels are no measurement.
        camera: intrinsics and pose.

    Returns:
        (H, W, 3) in the world, on the camera's side of the surface; NaN where there is none.

    Raises:
        ValueError: an argument is malformed; the message names it.
    """
    image = unmasked_depth(depth)
    if image.dtype not in (np.float32, np.uint16):
        raise ValueError(f"depth: expected dtype float32 (metres) or uint16 (millimetres), got {image.dtype}")
    if image.shape != (camera.height, camera.width):
        raise ValueError(f"depth: expected shape {(camera.height, camera.width)} as the camera has, got {image.shape}")
    # Absurd focal lengths make numbers that are not finite, and these no normal.
    with np.errstate(all="ignore"):
        inverse = _inverse(image)
        a, b, det, least = _fit(inverse, *_sums(inverse, camera))
        x, y = np.moveaxis(camera.pixel_rays()[..., :2], -1, 0)
        c = (1.0 - a * x) - b * y
        length = np.sqrt((a * a + b * b) + c * c)
        one = 1.0 / length
        local = [-a * one, -b * one, -c * one]
        pose = camera.camera_to_world
        normals = np.stack(
            [(pose[k, 0] * local[0] + pose[k, 1] * local[1]) + pose[k, 2] * local[2] for k in range(3)], -1
        )
        good = (inverse > 0.0) & (det > least) & (length >= MEASURED[0]) & (length <= MEASURED[1])
    normals[~good] = np.nan
    return normals


def displaced_samples(depth: Any, camera: Camera, bias: Bias) -> FloatArray:
    """The samples that :meth:`shadow_tracer.ShadowTracer.trace` makes of a depth image, (H, W, 3) in the world [m].

    Their rays start ``bias.constant + bias.quadratic * z**2`` from there. Arguments as for :func:`depth_normals`.
    """
    image = unmasked_depth(depth)
    z = image.astype(np.float64)
    if image.dtype == np.uint16:
        z /= 1000.0
    with np.errstate(all="ignore"):
        points = camera.unproject(z)
        if bias.normal == 0.0:
            return points
        length = np.minimum(bias.normal * np.minimum(bias.constant + bias.quadratic * (z * z), LARGEST), LARGEST)
        moved = points + length[..., None] * depth_normals(depth, camera)
        kept: FloatArray = np.where((np.abs(moved) <= LARGEST).all(axis=-1, keepdims=True), moved, points)
    return kept


def _inverse(image: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Inverse depth in the units of the image, 0 where nothing was measured."""
    raw = image.astype(np.float32)
    measured = (raw >= np.float32(MEASURED[0])) & (raw <= np.float32(MEASURED[1]))
    return np.where(measured, np.float32(1.0) / np.where(measured, raw, np.float32(1.0)), np.float32(0.0))


def _sums(inverse: npt.NDArray[np.float32], camera: Camera) -> Sums:
    """Of each pixel the sums of 1, x, y, xx, xy, yy, d, xd and yd of its neighbours, float32: x and y the distance of
    their rays from its own, d the difference of inverse depth."""
    height, width = inverse.shape
    (across, apart_x), (down, apart_y) = map(neighbours, focal_lengths(camera))
    across, down = min(across, width), min(down, height)  # farther than that is outside, too
    border = (down, down), (across, across)
    padded = np.pad(inverse, border)
    ways = None if camera.rays is None else np.pad(camera.rays.xy, (*border, (0, 0)), constant_values=np.nan)
    limit = np.float32(LARGEST_JUMP) * inverse
    sums = [np.zeros(inverse.shape, np.float32) for _ in range(9)]
    for row in (0, 1, 2):
        for column in (0, 1, 2):
            there = slice(row * down, row * down + height), slice(column * across, column * across + width)
            other = padded[there]
            d = other - inverse
            counts = (other > 0.0) & (np.abs(d) <= limit)
            x, y = np.float32((column - 1) * np.float32(apart_x)), np.float32((row - 1) * np.float32(apart_y))
            if camera.rays is not None and ways is not None:
                x, y = np.moveaxis(ways[there] - camera.rays.xy, -1, 0)
                counts &= ~np.isnan(x)
            d[~counts] = 0.0
            terms: tuple[Any, ...] = (np.float32(1.0), x, y, x * x, x * y, y * y, d, x * d, y * d)
            for total, term in zip(sums, terms, strict=True):
                total += np.where(counts, term, np.float32(0.0))
    return tuple(total.astype(np.float64) for total in sums)


def _fit(inverse: npt.NDArray[np.float32], w: FloatArray, *sums: FloatArray) -> Sums:
    """Slopes of inverse depth along x and y, as parts of inverse depth, the determinant of the fit, and what it must
    exceed."""
    x, y, xx, xy, yy, d, xd, yd = sums
    mxx, mxy, myy = w * xx - x * x, w * xy - x * y, w * yy - y * y
    mxd, myd = w * xd - x * d, w * yd - y * d
    det = mxx * myy - mxy * mxy
    scale = det * inverse.astype(np.float64)
    return (myy * mxd - mxy * myd) / scale, (mxx * myd - mxy * mxd) / scale, det, FLATTEST * (mxx * myy)
