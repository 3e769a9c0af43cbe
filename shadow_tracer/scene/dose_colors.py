# SPDX-License-Identifier: Apache-2.0
"""Colours of a dose."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.checks import FloatArray, real

REACHED = (230, 75, 45)
"""Of what has the dose that is wanted: a colour that viridis does not have."""
NEVER = (140, 140, 140)
"""Of what nothing has ever reached."""
# Viridis by van der Walt and Smith (CC0), as matplotlib has it, at equal steps; linear in between, within 6 of 255.
_VIRIDIS = np.array(
    [
        (68, 1, 84),
        (72, 24, 106),
        (71, 45, 123),
        (66, 64, 134),
        (59, 82, 139),
        (51, 99, 141),
        (44, 114, 142),
        (38, 130, 142),
        (33, 145, 140),
        (31, 160, 136),
        (40, 174, 128),
        (63, 188, 115),
        (94, 201, 98),
        (132, 212, 75),
        (173, 220, 48),
        (216, 226, 25),
        (253, 231, 37),
    ],
    np.float64,
)


def viridis(values: Any) -> npt.NDArray[np.uint8]:
    """(..., 3) red, green and blue of numbers from 0 to 1; others are cut off."""
    at = np.clip(np.asarray(values, np.float64), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(_VIRIDIS))
    colors = np.stack([np.interp(at, steps, _VIRIDIS[:, k]) for k in range(3)], axis=-1)
    return np.rint(colors).astype(np.uint8)


def check_dose(value: Any, field: str) -> float:
    """A positive, finite dose [J/m2], or ValueError that names ``field``."""
    dose = real(value)
    if not 0.0 < dose < np.inf:
        raise ValueError(f"{field}: expected a positive dose in J/m2, got {value!r}")
    return dose


def full_scale(dose: FloatArray, target: float | None) -> float:
    """The dose at the upper end of the colours [J/m2]: the target, or the largest dose there is.

    Raises:
        ValueError: the target is not a positive number.
    """
    return check_dose(target, "target") if target is not None else float(dose.max(initial=0.0)) or 1.0


def colors_of(dose: FloatArray, target: float | None) -> npt.NDArray[np.uint8]:
    """(N, 3) colour of each dose: viridis from 0 to the target, one flat colour from there on, grey of what has had
    none. Without a target viridis goes up to the largest dose."""
    colors = viridis(dose / full_scale(dose, target))
    if target is not None:
        colors[dose >= float(target)] = REACHED
    colors[dose == 0.0] = NEVER
    return colors
