# SPDX-License-Identifier: Apache-2.0
"""Vertices and triangles of meshes, checked on entry."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.checks import LARGEST, FloatArray, all_three, refuse_mask, unusable_vertices

IntArray = npt.NDArray[np.int32]


def own(array: npt.NDArray[Any], dtype: Any) -> npt.NDArray[Any]:
    """A copy of ``array`` that nobody else can change; the array itself if nobody can."""
    if array.dtype == dtype and array.flags.c_contiguous and array.flags.owndata and not array.flags.writeable:
        return array
    return np.array(array, dtype=dtype, order="C")


def vertices_of(value: Any) -> FloatArray:
    """(V, 3) positions, finite or not."""
    refuse_mask(value, "vertices")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"vertices: expected an array of shape (V, 3), got {type(value).__name__}") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"vertices: expected shape (V, 3), got {array.shape}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"vertices: expected real numbers, got dtype {array.dtype}")
    return cast(FloatArray, own(array, np.float64))


def usable(vertices: FloatArray, triangles: IntArray, nonfinite: str) -> FloatArray:
    """The vertices, read-only, with NaN for those that are not finite or too large; "refuse" allows these only where no
    triangle uses them."""
    if nonfinite not in ("refuse", "skip"):
        raise ValueError(f"nonfinite: expected 'refuse' or 'skip', got {nonfinite!r}")
    # NaN comes out of min and max and fails the comparison.
    if vertices.size and not (vertices.min() >= -LARGEST and vertices.max() <= LARGEST):
        bad = unusable_vertices(vertices, triangles)
        if nonfinite == "refuse" and len(bad):
            raise ValueError(
                f"vertices: expected finite coordinates of at most {LARGEST:g}, got {vertices[bad[0]].tolist()} at "
                f"vertex {bad[0]} (nonfinite='skip' keeps such a mesh and lets the triangles at such vertices cast "
                "nothing)"
            )
        good = all_three(np.abs(vertices) <= LARGEST)
        vertices = np.where(good[:, None], vertices, np.nan)
    vertices.setflags(write=False)
    return vertices


def triangles_of(value: Any, vertex_count: int) -> IntArray:
    refuse_mask(value, "triangles")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"triangles: expected an array of shape (T, 3), got ragged {type(value).__name__}") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"triangles: expected shape (T, 3), got {array.shape}")
    if array.size and array.dtype.kind not in "iu":
        raise ValueError(f"triangles: expected integer indices, got dtype {array.dtype}")
    if array.size:
        low, high = array.min(), array.max()
        if low < 0 or high >= vertex_count:
            outside = (array < 0) | (array >= vertex_count)
            row, column = (int(k) for k in np.argwhere(outside)[0])
            raise ValueError(
                f"triangles: expected indices from 0 to {vertex_count - 1}, got {int(array[row, column])} "
                f"at triangle {row}, corner {column}"
            )
    triangles = own(array, np.int32)
    triangles.setflags(write=False)
    return triangles


def equal(a: IntArray, b: IntArray) -> bool:
    # Other triangles mostly differ from the first on; that is told without reading all of them.
    return np.array_equal(a[:64], b[:64]) and np.array_equal(a, b)
