# SPDX-License-Identifier: Apache-2.0
"""Argument checks shared by the scene: every message starts with the field's name and says what was expected and what
came."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


LARGEST = 1e50
"""Coordinates and lengths beyond this [m] are refused: exact arithmetic needs room for their products."""


class BoundsError(ValueError):
    """An input is larger than a declared capacity. The message names the bound; nothing was changed."""


def vector3(value: Any, field: str) -> FloatArray:
    """Return ``value`` as three finite float64 numbers, or raise ValueError naming ``field``."""
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field}: expected three finite numbers, got {value!r}") from error
    if vector.shape != (3,) or not (np.abs(vector) <= LARGEST).all():
        raise ValueError(f"{field}: expected three finite numbers of at most {LARGEST:g}, got {value!r}")
    return vector.copy()


def direction3(value: Any, field: str) -> FloatArray:
    """Return ``value`` as three finite numbers that are not all zero (length is kept: the caller normalises)."""
    vector = vector3(value, field)
    length = float(np.linalg.norm(vector))
    if not 1e-30 <= length <= 1e30:
        raise ValueError(f"{field}: expected a direction of length between 1e-30 and 1e30, got {value!r}")
    return vector


def finite(value: Any, field: str) -> float:
    """Return ``value`` as a finite float, or raise ValueError naming ``field``."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field}: expected a finite number, got {value!r}") from error
    if not np.isfinite(number):
        raise ValueError(f"{field}: expected a finite number, got {value!r}")
    return number


def rigid_pose(value: Any, field: str) -> FloatArray:
    """Return ``value`` as a 4x4 rigid transform: finite, last row 0 0 0 1, rotation orthonormal within 1e-6,
    determinant +1."""
    try:
        pose = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field}: expected a 4x4 rigid transform, got {type(value).__name__}") from error
    if pose.shape != (4, 4):
        raise ValueError(f"{field}: expected a 4x4 rigid transform, got shape {pose.shape}")
    if not (np.abs(pose) <= LARGEST).all():
        raise ValueError(f"{field}: expected finite values of at most {LARGEST:g}, got {float(np.abs(pose).max()):g}")
    if not np.array_equal(pose[3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError(f"{field}: expected last row (0, 0, 0, 1), got {pose[3].tolist()}")
    rotation = pose[:3, :3]
    deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if deviation > 1e-6 or np.linalg.det(rotation) <= 0.0:
        raise ValueError(
            f"{field}: expected a rotation without scale, shear or mirroring; R R^T differs from identity by "
            f"{deviation:.3g} and the determinant is {np.linalg.det(rotation):.6g}"
        )
    return pose.copy()


def name_of(value: Any, field: str) -> str:
    """Return ``value`` as a non-empty string, or raise ValueError naming ``field``."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{field}: expected a non-empty string, got {value!r}")
    return value
