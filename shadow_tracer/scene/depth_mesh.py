# SPDX-License-Identifier: Apache-2.0
"""A depth image as an occluder: the surface the camera sees, as triangles between neighbouring pixels.

Every ``step``-th pixel is a corner, four corners a cell, two triangles a cell. Nothing is guessed: where a corner has
no depth, or where its depth jumps, which is the outline of something in front of something else, there is no triangle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import LARGEST, FloatArray, unmasked_depth

IntArray = npt.NDArray[np.int32]
_BoolArray = npt.NDArray[np.bool_]

_LARGEST_JUMP = 1e6
_BAND = 32768  # corners


def depth_mesh(depth: Any, camera: Camera, step: int, max_jump: float) -> tuple[FloatArray, IntArray]:
    """The surface in a depth image as a triangle mesh.

    Corners are the pixels in columns and rows 0, step, 2 step, ...; their vertices are exactly the samples that
    :meth:`ShadowTracer.trace` makes of these pixels. A cell is cut along the diagonal whose ends differ less in depth
    (the one from its upper left corner if both do alike), or along the only one that does not jump. A triangle is left
    out where one of its corners has no depth or no ray, or where one depth is more than ``1 + max_jump`` times another.
    Triangles are counter-clockwise seen from the camera.

    Args:
        depth: (H, W) float32 metres along the optical axis (zero, negative and non-finite values are no measurement)
            or uint16 millimetres (0 is none); masked pixels are no measurement.
        camera: intrinsics; its pose does not matter.
        step: pixels from corner to corner, at least 1.
        max_jump: the largest relative difference of depth within a triangle, above 0 and at most 1e6.

    Returns:
        ``vertices`` (V, 3) float64 in the optical frame [m], row by row, ``V = ceil(H / step) * ceil(W / step)``:
        corners without depth or ray are there too, at the origin, and belong to no triangle; and ``triangles`` (T, 3)
        int32. Both are read-only.

    Raises:
        ValueError: an argument is malformed; the message names it.
    """
    z, across, down = _corners(checked_depth(depth, camera, step, max_jump), camera, step)
    triangles = _triangles(z, max_jump)
    return _read_only(_vertices(z, across, down), triangles)


def depth_cells(image: npt.NDArray[Any], camera: Camera, step: int, max_jump: float) -> tuple[FloatArray, IntArray]:
    """As :func:`depth_mesh`, with two triangles for each cell, row by row, as the device has them: first that at the
    cell's left side, then the other one. One that is not there is the corner (0, 0) of its cell three times.

    Args:
        image: what :func:`checked_depth` has returned.
    """
    z, across, down = _corners(image, camera, step)
    rows, columns = z.shape
    corner = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)[:-1, :-1].reshape(-1, 1, 1)
    triangles = np.empty((corner.size, 2, 3), np.int32)
    triangles[...] = corner
    for number, (found, corners) in enumerate(_band(z, max_jump) if corner.size else ()):
        triangles[found - found // columns, number % 2] += np.array(corners, np.int32)
    return _read_only(_vertices(z, across, down), triangles.reshape(-1, 3))


def depth_box(image: npt.NDArray[Any], camera: Camera, step: int) -> tuple[FloatArray, FloatArray]:
    """Two corners of a box in the optical frame that holds all vertices of :func:`depth_mesh` [m]."""
    _, far = depth_range(image, step)
    sides = [(float(np.nanmin(way)) * far, float(np.nanmax(way)) * far) for way in corner_ways(camera, step)]
    low = np.array([max(min(least, 0.0), -LARGEST) for least, _ in sides] + [0.0])
    high = np.array([min(max(most, 0.0), LARGEST) for _, most in sides] + [far])
    return low, high


def depth_range(image: npt.NDArray[Any], step: int) -> tuple[float, float]:
    """The least and the largest depth of the corners that are measured [m]; (infinity, 0) if there are none."""
    picked = image[::step, ::step]
    if picked.dtype == np.uint16:
        near = int(np.subtract(picked, 1).min(initial=0xFFFF)) + 1  # what has no depth comes last: 0 - 1 is 65535
        return (near / 1000.0, int(picked.max()) / 1000.0) if near < 0x10000 else (np.inf, 0.0)
    there = (picked > 0) & (picked < np.inf)
    return float(np.min(picked, initial=np.inf, where=there)), float(np.max(picked, initial=0, where=there))


def corner_ways(camera: Camera, step: int) -> tuple[FloatArray, FloatArray]:
    """x and y at z = 1 of the rays of all corners: (1, C) and (R, 1), or both (R, C) and 0 where there is no ray."""
    across, down = camera.ways(*np.ogrid[: camera.height : step, : camera.width : step])
    if camera.rays is not None:
        missing = ~camera.rays.known[::step, ::step]
        across[missing], down[missing] = 0.0, 0.0
    return across, down


def _corners(image: npt.NDArray[Any], camera: Camera, step: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Depths of all corners [m], NaN where there is none, and their ways."""
    z = _corner_depths(image[::step, ::step])
    if camera.rays is not None:
        z[~camera.rays.known[::step, ::step]] = np.nan  # no ray, no measurement
    across, down = corner_ways(camera, step)
    _drop_huge(z, across, down)
    return z, across, down


def _read_only(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles


def checked_depth(depth: Any, camera: Camera, step: int, max_jump: float) -> npt.NDArray[Any]:
    """The depth image of :func:`depth_mesh`; its arguments are checked.

    Raises:
        ValueError: one is malformed; the message names it.
    """
    image = unmasked_depth(depth)
    if image.dtype not in (np.float32, np.uint16):
        raise ValueError(f"depth: expected dtype float32 (metres) or uint16 (millimetres), got {image.dtype}")
    if image.shape != (camera.height, camera.width):
        raise ValueError(f"depth: expected shape {(camera.height, camera.width)} as the camera has, got {image.shape}")
    if isinstance(step, bool) or not isinstance(step, (int, np.integer)) or step < 1:
        raise ValueError(f"step: expected an integer of at least 1, got {step!r}")
    if not 0.0 < max_jump <= _LARGEST_JUMP:
        raise ValueError(f"max_jump: expected a number above 0 and at most {_LARGEST_JUMP:g}, got {max_jump!r}")
    return image


def _corner_depths(picked: npt.NDArray[Any]) -> FloatArray:
    """Depths of the corners [m], NaN where nothing was measured: NaN is near to nothing."""
    z = picked.astype(np.float64)
    if picked.dtype == np.uint16:
        z /= 1000.0
        z[picked == 0] = np.nan
    else:
        z[~((z > 0.0) & (z < np.inf))] = np.nan
    return z


def _drop_huge(z: FloatArray, across: FloatArray, down: FloatArray) -> None:
    """Corners whose coordinates would be too large to calculate with become NaN. Only absurd focal lengths make
    such."""
    steepest = max(float(np.abs(across).max()), float(np.abs(down).max()))
    if steepest > LARGEST / float(np.finfo(np.float32).max):
        with np.errstate(over="ignore", invalid="ignore"):
            z[~((np.abs(across * z) <= LARGEST) & (np.abs(down * z) <= LARGEST))] = np.nan


def _triangles(z: FloatArray, max_jump: float) -> IntArray:
    """Triangles between corners, which are numbered row by row."""
    rows, columns = z.shape
    triangles = np.empty((2 * (rows - 1) * (columns - 1), 3), np.int32)
    # A band of rows at a time: what is calculated on the way stays in the cache.
    height = max(1, _BAND // columns)
    count = 0
    for first in range(0, rows - 1, height):
        for found, corners in _band(z[first : first + height + 1], max_jump):
            end = count + len(found)
            for k, corner in enumerate(corners):
                np.add(found, first * columns + corner, out=triangles[count:end, k], casting="same_kind")
            count = end
    triangles.resize((count, 3), refcheck=False)
    return triangles


def _band(z: FloatArray, max_jump: float) -> list[tuple[npt.NDArray[np.intp], tuple[int, int, int]]]:
    """Of the corners a b above and c d below of each cell: for each of the four triangles there can be, the cells that
    have it, numbered as their corner a is, and its corners as distances from a."""
    rows, columns = z.shape
    limit = z * (1.0 + max_jump)

    def near(first: tuple[slice, slice], second: tuple[slice, slice]) -> _BoolArray:
        result: _BoolArray = z[first] <= limit[second]
        result &= z[second] <= limit[first]
        return result

    every, head, tail = slice(None), slice(None, -1), slice(1, None)
    across, down = near((every, head), (every, tail)), near((head, every), (tail, every))
    top, bottom, left, right = across[head], across[tail], down[:, head], down[:, tail]
    falling, rising = near((head, head), (tail, tail)), near((head, tail), (tail, head))
    steeper = np.abs(z[head, head] - z[tail, tail]) > np.abs(z[head, tail] - z[tail, head])
    falling &= ~(steeper & rising)
    rising &= ~falling
    # The last column has no cell; it is there for the numbering.
    cells = np.zeros((rows - 1, columns), np.bool_)
    found = []
    a, b, c, d = 0, 1, columns, columns + 1
    for kept, corners in (
        (falling & left & bottom, (a, c, d)),
        (falling & right & top, (a, d, b)),
        (rising & left & top, (a, c, b)),
        (rising & right & bottom, (b, c, d)),
    ):
        cells[:, head] = kept
        found.append((np.flatnonzero(cells), corners))
    return found


def _vertices(z: FloatArray, across: FloatArray, down: FloatArray) -> FloatArray:
    vertices = np.empty((z.size, 3))
    grid = vertices.reshape(*z.shape, 3)
    z[np.isnan(z)] = 0.0
    np.multiply(across, z, out=grid[..., 0])
    np.multiply(down, z, out=grid[..., 1])
    grid[..., 2] = z
    return vertices
