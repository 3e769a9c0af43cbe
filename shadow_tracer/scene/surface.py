# SPDX-License-Identifier: Apache-2.0
"""Organised surfaces: positions in rows and columns, and the triangles of the quads between them.

A surface is a mesh whose triangles follow from its shape: quad (r, c) lies between the positions (r, c), (r, c + 1),
(r + 1, c) and (r + 1, c + 1), and quads are numbered row by row. It is cut along the diagonal from (r, c) to
(r + 1, c + 1), into the triangles 2 q: (r, c), (r + 1, c), (r + 1, c + 1), and 2 q + 1: (r, c), (r + 1, c + 1),
(r, c + 1). Where one of the two ends of that diagonal alone is not valid, the quad is cut along the other one, so that
of a quad with one position that is not valid the triangle of the other three always stands, as in ``depth_mesh.py``.
Triangles at positions that are not valid cast nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.checks import LARGEST, FloatArray, finite, real, refuse_mask, refuse_units, vector3

IntArray = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]

_COARSEST = 15  # level
_UNIT = 1e-6  # how far axes may be from unit length and a right angle


class HeightField:
    """Heights over a regular grid in the x, y plane: the regular case of a surface.

    The position of row ``r`` and column ``c`` is ``origin + r * resolution[0] * axes[0] + c * resolution[1] * axes[1]``
    in x and y, and ``origin[2] + z[r, c]`` in z.

    Args:
        z: (R, C) heights [m], R and C at least 1; what is masked of a masked array is not valid.
        resolution: distance from row to row and from column to column [m], or one number for both; above 0.
        origin: x, y, z of row 0, column 0, and of height 0 [m].
        axes: the directions in which rows and columns follow each other, two unit vectors (x, y) at a right angle; by
            default rows go south (-y) and columns east (+x), as in a map.
        invalid: the height that says that there is none; NaN always says so.

    Raises:
        ValueError: an argument is malformed; the message names it.
    """

    def __init__(
        self,
        z: Any,
        resolution: Any,
        origin: Any = (0.0, 0.0, 0.0),
        axes: Any = ((0.0, -1.0), (1.0, 0.0)),
        invalid: float = float("nan"),
    ) -> None:
        heights, known = _heights(z)
        missing = real(invalid)
        if np.isnan(missing) and not _is_nan(invalid):
            raise ValueError(f"invalid: expected a number or NaN, got {invalid!r}")
        self.valid: BoolArray = known & ~(np.isnan(heights) | (heights == missing))
        """(R, C) which heights there are; read-only."""
        wrong = np.argwhere(self.valid & ~(np.abs(heights) <= LARGEST))
        if len(wrong):
            row, column = (int(k) for k in wrong[0])
            raise ValueError(
                f"z: expected heights of at most {LARGEST:g}, NaN or {invalid!r}, got {heights[row, column]} at row "
                f"{row}, column {column}"
            )
        self.z: FloatArray = np.where(self.valid, heights, np.nan)
        """(R, C) float64 heights [m], NaN where there is none; read-only."""
        self.resolution = _resolution(resolution)
        """Distance from row to row and from column to column [m]."""
        self.origin: FloatArray = vector3(origin, "origin")
        """(3,) position of row 0, column 0 at height 0 [m]."""
        self.axes: FloatArray = _axes(axes)
        """(2, 2) directions (x, y) in which rows, and columns, follow each other."""
        for array in (self.valid, self.z, self.origin, self.axes):
            array.setflags(write=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.z.shape
        return rows, columns

    def positions(self) -> FloatArray:
        """(R, C, 3) positions [m], NaN in z where there is no height."""
        rows, columns = self.shape
        down, across = np.arange(rows) * self.resolution[0], np.arange(columns) * self.resolution[1]
        found = np.empty((rows, columns, 3))
        for k in range(2):
            found[..., k] = (self.origin[k] + down * self.axes[0, k])[:, None] + across * self.axes[1, k]
        np.add(self.z, self.origin[2], out=found[..., 2])
        return found


@dataclass(frozen=True)
class Sampling:
    """Which of the rows and columns that a surface was given it has: every 2**level-th from the first on, and the last,
    so that its borders end where they did, and charts that met there still do.

    Attributes:
        rows, columns: how many it was given.
    """

    rows: int
    columns: int
    level: int = 0

    def kept(self) -> tuple[IntArray, IntArray]:
        """Numbers of these rows and columns."""
        found = []
        for count in (self.rows, self.columns):
            some = np.arange(0, count, 2**self.level, dtype=np.int32)
            found.append(some if some[-1] == count - 1 else np.append(some, np.int32(count - 1)))
        return found[0], found[1]

    def whole(self, valid: BoolArray) -> BoolArray:
        """Which positions that are kept have valid ones alone around them, up to the next that are kept: so that no
        quad reaches over what is not valid, a gutter between charts, say."""
        sums = np.zeros((self.rows + 1, self.columns + 1), np.int64)
        np.cumsum(np.cumsum(~valid, axis=0), axis=1, out=sums[1:, 1:])
        rows, columns = self.kept()
        above, left = (np.append(each[:1], each[:-1])[:, None] for each in (rows, columns))
        below, right = (np.append(each[1:], each[-1:])[:, None] + 1 for each in (rows, columns))
        left, right = left.T, right.T
        missing = sums[below, right] - sums[above, right] - sums[below, left] + sums[above, left]
        return cast(BoolArray, missing == 0)

    @property
    def grid(self) -> tuple[int, int]:
        """How many rows and columns these are."""
        rows, columns = self.kept()
        return len(rows), len(columns)


@dataclass(frozen=True)
class Organised:
    """A surface's arguments, checked.

    Attributes:
        vertices: (R * C, 3) positions row by row, NaN where they are not valid; read-only.
        valid: (R, C).
        sampling: what was given, of which these are some.
    """

    vertices: FloatArray
    valid: BoolArray
    sampling: Sampling

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.valid.shape
        return rows, columns

    @property
    def triangle_count(self) -> int:
        """Triangles of all quads."""
        rows, columns = self.grid
        return 2 * (rows - 1) * (columns - 1)

    def triangles(self) -> IntArray:
        """(T, 3) vertex numbers of them; read-only."""
        rows, columns = self.grid
        triangles = np.empty((self.triangle_count // 2, 2, 3), np.int32)
        down = np.arange(rows - 1, dtype=np.int32)[:, None] * np.int32(columns)
        a = (down + np.arange(columns - 1, dtype=np.int32)).reshape(-1)
        b, c, d = a + np.int32(1), a + np.int32(columns), a + np.int32(columns + 1)
        for number, corners in enumerate(((a, c, d), (a, d, b))):
            for k, corner in enumerate(corners):
                triangles[:, number, k] = corner
        valid = self.valid
        other = ~(valid[:-1, :-1] & valid[1:, 1:]) & valid[:-1, 1:] & valid[1:, :-1]
        if other.any():
            quads = other.reshape(-1)
            triangles[quads, 0] = np.stack([a, c, b], axis=-1)[quads]
            triangles[quads, 1] = np.stack([b, c, d], axis=-1)[quads]
        made = triangles.reshape(-1, 3)
        made.setflags(write=False)
        return made


def organised(positions: Any, valid: Any, known: BoolArray | None = None, level: Any = 0) -> Organised:
    """Check a surface's positions and mask; what is left out for the level is not looked at.

    Args:
        positions: (R, C, 3) real numbers [m], or a :class:`HeightField`; what has been checked comes back as it is.
        valid: (R, C) truth values, or None for ``known``, and if that is None for all (of a height field all that have
            a height).
        known: (R', C') of the rows and columns that are kept.
        level: see ``Sampling``.

    Raises:
        ValueError: an argument is malformed, or a position that is valid is not finite or beyond 1e50.
    """
    if isinstance(positions, Organised) and valid is None:
        return positions
    if isinstance(positions, HeightField):
        grid, own = positions.positions(), positions.valid
    else:
        grid, own = _grid(positions), None
    if isinstance(level, bool) or not isinstance(level, (int, np.integer)) or not 0 <= level <= _COARSEST:
        raise ValueError(f"level: expected an integer from 0 to {_COARSEST}, got {level!r}")
    rows, columns = grid.shape[:2]
    sampling = Sampling(rows, columns, int(level))
    kept = sampling.kept()
    shape, some = (len(kept[0]), len(kept[1])), np.ix_(*kept)
    mask = _mask(valid, rows, columns) if valid is not None else None
    if own is not None:
        mask = own if mask is None else mask & own
    if sampling.level:
        grid = grid[some]
        mask = None if mask is None else sampling.whole(mask)
    if mask is None:
        mask = np.ones(shape, np.bool_) if known is None or known.shape != shape else known
    vertices = grid.reshape(-1, 3)
    flat = mask.reshape(-1)
    good = np.abs(vertices) <= LARGEST  # NaN compares false
    wrong = flat & ~(good[:, 0] & good[:, 1] & good[:, 2])
    if wrong.any():
        row, column = divmod(int(np.flatnonzero(wrong)[0]), shape[1])
        raise ValueError(
            f"positions: expected finite coordinates of at most {LARGEST:g} where they are valid, got "
            f"{grid[row, column].tolist()} at row {kept[0][row]}, column {kept[1][column]} (give valid= to leave "
            "positions out)"
        )
    vertices[~flat] = np.nan
    vertices.setflags(write=False)
    return Organised(vertices, mask, sampling)


def _is_nan(value: Any) -> bool:
    return isinstance(value, (float, np.floating)) and bool(np.isnan(value))


def _heights(z: Any) -> tuple[FloatArray, BoolArray]:
    """(R, C) heights, and where they are not masked."""
    refuse_units(z, "z")
    try:
        array = np.ma.getdata(z) if isinstance(z, np.ma.MaskedArray) else np.asarray(z)
    except ValueError as error:
        raise ValueError(f"z: expected an array of shape (R, C), got {type(z).__name__}") from error
    if array.ndim != 2 or 0 in array.shape:
        raise ValueError(f"z: expected shape (R, C) with R and C at least 1, got {array.shape}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"z: expected real numbers, got dtype {array.dtype}")
    masked = np.ma.getmaskarray(z) if isinstance(z, np.ma.MaskedArray) else np.zeros(array.shape, np.bool_)
    return array.astype(np.float64), ~masked


def _resolution(value: Any) -> tuple[float, float]:
    pair = (value, value) if np.ndim(value) == 0 else tuple(value)
    if len(pair) != 2:
        raise ValueError(f"resolution: expected a number, or two for rows and columns, got {value!r}")
    rows, columns = (finite(each, "resolution") for each in pair)
    if not (1e-9 <= rows <= 1e9 and 1e-9 <= columns <= 1e9):
        raise ValueError(f"resolution: expected distances from 1e-9 to 1e9, got {value!r}")
    return rows, columns


def _axes(value: Any) -> FloatArray:
    refuse_mask(value, "axes")
    expected = "expected two unit vectors (x, y) at a right angle"
    try:
        axes = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"axes: {expected}, got {value!r}") from error
    if axes.shape != (2, 2) or not (np.abs(axes @ axes.T - np.eye(2)) <= _UNIT).all():
        raise ValueError(f"axes: {expected}, got {value!r}")
    return axes


def _grid(value: Any) -> FloatArray:
    """(R, C, 3) float64 positions, a copy."""
    refuse_mask(value, "positions")
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"positions: expected an array of shape (R, C, 3), got {type(value).__name__}") from error
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise ValueError(f"positions: expected shape (R, C, 3) with R and C at least 1, got {array.shape}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"positions: expected real numbers, got dtype {array.dtype}")
    return cast(FloatArray, np.array(array, dtype=np.float64, order="C"))


def _mask(value: Any, rows: int, columns: int) -> BoolArray:
    refuse_mask(value, "valid")
    expected = f"expected truth values of shape {(rows, columns)}"
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"valid: {expected}, got {type(value).__name__}") from error
    if array.shape != (rows, columns) or array.dtype != np.bool_:
        raise ValueError(f"valid: {expected}, got {array.dtype} {array.shape}")
    return cast(BoolArray, array.copy())
