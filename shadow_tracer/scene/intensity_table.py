# SPDX-License-Identifier: Apache-2.0
"""How strong a light is in each direction, as a table; from files of IES LM-63."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.scene.checks import FloatArray, direction3, real, reals

UNITS = {"W/sr": 1.0, "mW/sr": 1e-3, "uW/cm2 at 1 m": 1e-2, "cd": 1.0}
"""What one of a file's numbers is in W/sr; of candela before it is divided by lumens per watt."""
LARGEST_EFFICACY = 683.1  # lm/W: 683.002 of 555 nm
_TURN = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class IntensityTable:
    """Radiant intensity over the directions of a light, in the angles of photometric files of type C; in between it is
    linear in both angles, beyond the vertical angles it is 0.

    Args:
        vertical: (V,) angles from ``axis`` [rad], ascending, from 0 to pi, at least two.
        horizontal: (H,) angles around the axis from ``zero`` [rad]: (0.0,) if the light is the same all around; else
            ascending from 0 to 2 pi. They grow counter-clockwise seen against the axis (from above, if it points
            down).
        values: (H, V) intensities [W/sr], 0 or more, some of them positive; of 0 and 2 pi the same.
        axis: (3,) where the vertical angle is 0, in the world; down by default.
        zero: (3,) where the horizontal angle is 0, in the world, at right angles to the axis.

    Raises:
        ValueError: an argument is malformed; the message names it.
    """

    vertical: Any
    horizontal: Any
    values: Any
    axis: Any = (0.0, 0.0, -1.0)
    zero: Any = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        vertical = _angles(self.vertical, "vertical", math.pi)
        horizontal = _angles(self.horizontal, "horizontal", _TURN)
        if len(vertical) < 2:
            raise ValueError(f"vertical: expected at least two angles, got {vertical.tolist()}")
        if horizontal[0] != 0.0 or (len(horizontal) > 1 and not abs(horizontal[-1] - _TURN) <= 1e-9):
            raise ValueError(f"horizontal: expected (0.0,), or angles from 0 to 2 pi, got {horizontal.tolist()}")
        values = _numbers(self.values, "values")
        if values.shape != (len(horizontal), len(vertical)):
            raise ValueError(f"values: expected shape {(len(horizontal), len(vertical))}, got {values.shape}")
        if not (values >= 0.0).all() or not 0.0 < values.max() <= 1e30:
            raise ValueError("values: expected intensities of 0 to 1e30 W/sr, some of them positive")
        if not np.array_equal(values[0], values[-1]):
            raise ValueError("values: expected the same at the horizontal angles 0 and 2 pi")
        for name, array in (("vertical", vertical), ("horizontal", horizontal), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        self._hang(self.axis, self.zero)

    def _hang(self, along: Any, around: Any) -> None:
        axis, zero = direction3(along, "axis"), direction3(around, "zero")
        axis, zero = axis / np.linalg.norm(axis), zero / np.linalg.norm(zero)
        if not abs(float(axis @ zero)) <= 1e-6:
            raise ValueError(f"zero: expected a direction at right angles to axis = {along!r}, got {around!r}")
        for name, array in (("axis", axis), ("zero", zero)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def hung(self, axis: Any, zero: Any) -> IntensityTable:
        """The same light hanging otherwise; its numbers are the same arrays.

        Args:
            axis, zero: as for the class.

        Raises:
            ValueError: as for the class.
        """
        made = copy.copy(self)
        made._hang(axis, zero)
        return made

    @property
    def peak(self) -> float:
        """The largest intensity [W/sr]."""
        return float(self.values.max())

    @property
    def power(self) -> float:
        """The sum over all directions [W], of what is linear in between exactly."""
        # Of a line between two angles times the sine: integrated by parts.
        low, high = self.vertical[:-1], self.vertical[1:]
        slope = np.diff(self.values, axis=1) / (high - low)
        rings = self.values[:, :-1] * np.cos(low) - self.values[:, 1:] * np.cos(high)
        rings = (rings + slope * (np.sin(high) - np.sin(low))).sum(axis=1)
        if len(self.horizontal) == 1:
            return float(rings[0] * _TURN)
        return float((0.5 * (rings[1:] + rings[:-1]) * np.diff(self.horizontal)).sum())

    def towards(self, directions: FloatArray) -> FloatArray:
        """(N,) intensity [W/sr] in (N, 3) directions in the world, away from the light and of any length but zero."""
        frame = self.zero, np.cross(-self.axis, self.zero), self.axis
        ways = directions.T  # summed in the order x, y, z, as nobody's BLAS is asked
        x, y, down = (ways[0] * way[0] + ways[1] * way[1] + ways[2] * way[2] for way in frame)
        vertical = np.arctan2(np.hypot(x, y), down)
        row, up = _between(self.vertical, vertical)
        if len(self.horizontal) == 1:
            values = (1.0 - up) * self.values[0, row] + up * self.values[0, row + 1]
        else:
            column, on = _between(self.horizontal, np.arctan2(y, x) % _TURN)
            near = (1.0 - up) * self.values[column, row] + up * self.values[column, row + 1]
            far = (1.0 - up) * self.values[column + 1, row] + up * self.values[column + 1, row + 1]
            values = (1.0 - on) * near + on * far
        outside = (vertical < self.vertical[0]) | (vertical > self.vertical[-1])
        return np.where(outside, 0.0, values)

    @classmethod
    def from_ies(
        cls,
        path: str | Path,
        unit: str,
        lumens_per_watt: float | None = None,
        axis: Any = (0.0, 0.0, -1.0),
        zero: Any = (1.0, 0.0, 0.0),
    ) -> IntensityTable:
        """The table of an IES LM-63 file of type C, read by photompy (extra ``photometry``).

        Such a file says candela, whatever was measured: candela weighs radiation by how the eye sees it, so it says
        nothing of ultraviolet and infrared, and the files of UV lamps hold other units. So the unit is asked for. The
        file's multiplier and ballast factor are applied.

        Args:
            path: the file.
            unit: what the file's numbers are: ``"W/sr"``, ``"mW/sr"``, ``"uW/cm2 at 1 m"`` (one is 0.01 W/sr) or
                ``"cd"``.
            lumens_per_watt: for ``"cd"`` alone: luminous flux of a watt of this lamp's radiation [lm/W], by its
                spectrum (683 at 555 nm, about 300 of white LEDs); intensity [W/sr] is candela divided by it.
            axis, zero: how the light hangs, as for the class.

        Raises:
            ValueError: an argument is malformed, or the file is; the message names it.
            ImportError: photompy is not installed; the message says how to install it.
        """
        if unit not in UNITS:
            raise ValueError(f"unit: expected one of {', '.join(map(repr, UNITS))}, got {unit!r}")
        factor = UNITS[unit]
        if unit == "cd":
            efficacy = real(lumens_per_watt)
            if not 0.0 < efficacy <= LARGEST_EFFICACY:
                raise ValueError(
                    "lumens_per_watt: candela need it, a number above 0 and at most 683.002 [lm/W] by the lamp's "
                    f"spectrum, got {lumens_per_watt!r}; for ultraviolet and infrared there is none"
                )
            factor /= efficacy
        elif lumens_per_watt is not None:
            raise ValueError(f"lumens_per_watt: belongs to the unit 'cd' alone, got {lumens_per_watt!r} for {unit!r}")
        vertical, horizontal, values = _read_ies(Path(path))
        return cls(np.radians(vertical), np.radians(horizontal), factor * values, axis, zero)


def _angles(value: Any, field: str, most: float) -> FloatArray:
    angles = _numbers(value, field)
    if (
        angles.ndim != 1
        or not len(angles)
        or angles[0] < 0.0
        or angles[-1] > most + 1e-9
        or (np.diff(angles) <= 0).any()
    ):
        raise ValueError(f"{field}: expected ascending angles from 0 to {most:.6g} rad, got {angles.tolist()}")
    return angles


def _numbers(value: Any, field: str) -> FloatArray:
    array = reals(value, field, "real numbers")
    if not np.isfinite(array).all():
        raise ValueError(f"{field}: expected finite numbers, got {array.tolist()}")
    return array


def _between(angles: FloatArray, at: FloatArray) -> tuple[Any, FloatArray]:
    """Between which two angles, and how far from the first to the second, 0 to 1."""
    first = np.clip(np.searchsorted(angles, at, side="right") - 1, 0, len(angles) - 2)
    part = (at - angles[first]) / (angles[first + 1] - angles[first])
    return first, np.clip(part, 0.0, 1.0)


def _read_ies(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vertical (V,) and horizontal (H,) angles [degrees], of all around, and (H, V) numbers of a file."""
    try:
        from photompy import IESFile
    except ModuleNotFoundError as error:
        if error.name != "photompy":
            raise
        raise ImportError("IES files need photompy: pip install 'shadow_tracer[photometry]'") from error
    try:
        file = IESFile.read(path)
    except OSError as error:
        raise ValueError(f"path: expected an IES file, {error}") from error
    except Exception as error:  # of its many kinds none is a ValueError
        raise ValueError(f"path: expected a file of IES LM-63, got {str(path)!r}: {error}") from error
    table, header = file.photometry, file.header
    if header.tilt not in (None, "NONE"):
        raise ValueError("path: expected a file with TILT=NONE; what a lamp loses when tilted is not applied here")
    if table.photometric_type.name != "C":
        raise ValueError(f"path: expected a file of photometric type C, got type {table.photometric_type.name}")
    values = np.asarray(table.values, np.float64) * float(header.ballast_factor)
    horizontal, values = _all_around(np.asarray(table.phis, np.float64), values)
    return np.asarray(table.thetas, np.float64), horizontal, values


def _all_around(horizontal: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Horizontal angles [degrees] from 0 to 360, and their values, where a file leaves out what is symmetric."""
    first, last = float(horizontal[0]), float(horizontal[-1])
    if len(horizontal) == 1:
        return np.zeros(1), values
    for whole in (90.0, 180.0):
        if (first, last) == (0.0, whole):
            horizontal = np.concatenate([horizontal, 2.0 * whole - horizontal[-2::-1]])
            values = np.vstack([values, values[-2::-1]])
            first, last = 0.0, 2.0 * whole
    if (first, last) != (0.0, 360.0):
        raise ValueError(
            f"path: expected horizontal angles of 0, 0 to 90, 0 to 180 or 0 to 360 degrees, got {first:g} to {last:g}"
        )
    return horizontal, values
