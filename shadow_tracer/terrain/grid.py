# SPDX-License-Identifier: Apache-2.0
"""Where the cells of an elevation model are: metres from its first cell, the same bits whichever part is asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.surface import HeightField

FloatArray = npt.NDArray[np.float64]

EARTH_RADIUS = 6_371_008.8
"""Mean radius of the Earth (IUGG) [m]."""
FARTHEST_FLAT, FARTHEST_CURVED = 10_000.0, 100_000.0
"""How far cells may be from the centre, without and with curvature [m]."""


@dataclass(frozen=True)
class Grid:
    """A regular grid of heights, the value of each belonging to a point, the centre of its cell.

    The point of row ``r``, column ``c`` is ``r * row_step + c * column_step``: x along grid east, y along grid north.
    With ``curved`` heights are lowered by d^2 / 2R, where d is the distance from the centre of the grid: what a plane
    that touches the sphere there has above it. Then one direction of the sun holds for all of it.

    Attributes:
        rows, columns: of the whole model, each at least 1.
        row_step, column_step: x and y from a row, or column, to the next [m]; at a right angle.
        curved: whether the Earth is a sphere.
    """

    rows: int
    columns: int
    row_step: tuple[float, float]
    column_step: tuple[float, float]
    curved: bool = False

    @classmethod
    def of(cls, field: HeightField, curved: bool = False) -> Grid:
        """The grid of a height field, without its origin."""
        (down, right), axes = field.resolution, field.axes
        row_step = float(down * axes[0, 0]), float(down * axes[0, 1])
        return cls(*field.shape, row_step, (float(right * axes[1, 0]), float(right * axes[1, 1])), curved)

    def checked(self) -> Grid:
        """This grid.

        Raises:
            ValueError: it is larger than it may be; the message says why, and what helps.
        """
        farthest = self.reach()
        if not self.curved and farthest > FARTHEST_FLAT:
            raise ValueError(
                f"height_field: its corners are {farthest / 1000:.1f} km from its centre, where the Earth has "
                f"fallen by {farthest**2 / (2 * EARTH_RADIUS):.0f} m and the sun stands up to "
                f"{math.degrees(farthest / EARTH_RADIUS):.2f} degrees higher or lower; expected at most "
                f"{FARTHEST_FLAT / 1000:.0f} km on a plane: ask for curvature, or cut the model"
            )
        if farthest > FARTHEST_CURVED:
            raise ValueError(
                f"height_field: its corners are {farthest / 1000:.1f} km from its centre; expected at most "
                f"{FARTHEST_CURVED / 1000:.0f} km, beyond which one direction of the sun and d^2 / 2R do not hold: cut "
                "the model"
            )
        return self

    def reach(self) -> float:
        """Distance of the farthest cell from the centre of the grid [m]."""
        corners = [self._along(r, c) for r in (0, self.rows - 1) for c in (0, self.columns - 1)]
        x0, y0 = self._along((self.rows - 1) / 2, (self.columns - 1) / 2)
        return max(math.hypot(x - x0, y - y0) for x, y in corners)

    def plane(self, rows: slice, columns: slice) -> tuple[FloatArray, FloatArray]:
        """(R, C) x and y of some cells [m]; rows and columns may lie beside the grid."""
        r = np.arange(rows.start, rows.stop, dtype=np.float64)[:, None]
        c = np.arange(columns.start, columns.stop, dtype=np.float64)[None, :]
        x, y = (r * self.row_step[k] + c * self.column_step[k] for k in (0, 1))
        return x, y

    def drop(self, rows: slice, columns: slice) -> FloatArray:
        """(R, C) how far the sphere is below the plane at some cells [m]; zeros where the grid is not curved."""
        x, y = self.plane(rows, columns)
        if not self.curved:
            return np.zeros_like(x)
        x0, y0 = self._along((self.rows - 1) / 2, (self.columns - 1) / 2)
        return np.asarray(((x - x0) * (x - x0) + (y - y0) * (y - y0)) / (2.0 * EARTH_RADIUS))

    def cells(self, direction: tuple[float, float], distance: float) -> tuple[float, float]:
        """How many rows and columns a way leads on: x and y of a direction, of any length, and how often that."""
        x, y = (distance * part for part in direction)
        rows, columns = (
            (x * step[0] + y * step[1]) / (step[0] * step[0] + step[1] * step[1])
            for step in (self.row_step, self.column_step)
        )
        return rows, columns

    def _along(self, row: float, column: float) -> tuple[float, float]:
        x, y = (row * self.row_step[k] + column * self.column_step[k] for k in (0, 1))
        return x, y


def slopes(grid: Grid, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How much a surface rises along x and y at each of its cells.

    Central differences; one-sided where only one neighbour of a row, or column, is known.

    Args:
        grid: which steps it has.
        z: (R, C) heights [m], NaN where there is none.

    Returns:
        Two (R, C) arrays, NaN where there is no height, or no neighbour along rows or along columns.
    """
    along = [_difference(z, axis) for axis in (0, 1)]
    lengths = [step[0] * step[0] + step[1] * step[1] for step in (grid.row_step, grid.column_step)]
    x, y = (along[0] * (grid.row_step[k] / lengths[0]) + along[1] * (grid.column_step[k] / lengths[1]) for k in (0, 1))
    return x, y


def _difference(z: FloatArray, axis: int) -> FloatArray:
    """From each cell to the next along an axis."""
    padded = np.pad(z, [(1, 1) if k == axis else (0, 0) for k in (0, 1)], constant_values=np.nan)
    before, after = (np.take(padded, np.arange(k, k + z.shape[axis]), axis=axis) for k in (0, 2))
    both = (after - before) * 0.5
    return np.where(
        np.isnan(z), np.nan, np.where(np.isnan(after), z - before, np.where(np.isnan(before), after - z, both))
    )
