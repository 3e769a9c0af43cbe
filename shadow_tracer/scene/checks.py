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


def refuse_units(value: Any, field: str) -> None:
    """Raise ValueError if ``value`` is a quantity of astropy, pint or the like: an array made of it has lost its
    unit."""
    if type(value).__name__ == "Quantity":
        raise ValueError(f"{field}: expected plain numbers, got a quantity with a unit; give metres or radians")


def unmasked_depth(depth: Any) -> npt.NDArray[Any]:
    """``depth`` as an array; masked pixels of a masked array hold no measurement: NaN, or 0 if it is of integers."""
    refuse_units(depth, "depth")
    if isinstance(depth, np.ma.MaskedArray):
        return np.asarray(depth.filled(np.nan if depth.dtype.kind == "f" else 0))
    try:
        return np.asarray(depth)
    except ValueError as error:
        raise ValueError(f"depth: expected an image of shape (H, W), got {type(depth).__name__}") from error


def refuse_mask(value: Any, field: str) -> None:
    """Raise ValueError if ``value`` is a masked array in which something is masked: there is no value then, and what
    lies under the mask must not be taken for one. So are quantities with a unit."""
    refuse_units(value, field)
    count = int(np.ma.count_masked(value)) if isinstance(value, np.ma.MaskedArray) else 0
    if count:
        raise ValueError(f"{field}: expected an array without masked values, got {count}; fill or leave them out first")


def reals(value: Any, field: str, expected: str) -> FloatArray:
    """``value`` as a float64 array. Texts, truth values and complex numbers are refused, not converted."""
    refuse_mask(value, field)
    try:
        array = np.asarray(value)
        if array.dtype.kind in "fiuO":
            return np.array(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{field}: expected {expected}, got {value!r}") from error
    raise ValueError(f"{field}: expected {expected}, got {value!r}")


def vector3(value: Any, field: str) -> FloatArray:
    """Return ``value`` as three finite float64 numbers, or raise ValueError naming ``field``."""
    vector = reals(value, field, "three finite numbers")
    if vector.shape != (3,) or not (np.abs(vector) <= LARGEST).all():
        raise ValueError(f"{field}: expected three finite numbers of at most {LARGEST:g}, got {value!r}")
    return vector


def valid_points(points: FloatArray) -> npt.NDArray[np.bool_] | None:
    """Which of (N, 3) points have only coordinates that are finite and at most ``LARGEST``; None if all do."""
    # Extremes of all coordinates take an eighth of the time of an answer per row. NaN comes out of them and fails.
    if points.min(initial=0.0) >= -LARGEST and points.max(initial=0.0) <= LARGEST:
        return None
    return all_three(np.abs(points) <= LARGEST)


def all_three(good: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """``good.all(axis=1)`` of an (N, 3) array, in a fraction of the time."""
    return good[:, 0] & good[:, 1] & good[:, 2]


def positions_of(points: Any) -> tuple[npt.NDArray[Any], FloatArray]:
    """``points`` as an array (..., 3), and as float64 (N, 3) in C order; what is masked is NaN. Raises ValueError."""
    refuse_units(points, "points")
    try:
        masked = isinstance(points, np.ma.MaskedArray)
        positions = np.asarray(points.astype(np.float64).filled(np.nan) if masked else points)
    except (TypeError, ValueError) as error:
        raise ValueError(f"points: expected real numbers of shape (..., 3), got {type(points).__name__}") from error
    if positions.ndim == 0 or positions.shape[-1] != 3 or positions.dtype.kind not in "fiu":
        raise ValueError(
            f"points: expected real numbers of shape (..., 3), got shape {positions.shape} of {positions.dtype}"
        )
    return positions, np.ascontiguousarray(positions, dtype=np.float64).reshape(-1, 3)


def direction3(value: Any, field: str) -> FloatArray:
    """Return ``value`` as three finite numbers that are not all zero (length is kept: the caller normalises)."""
    vector = vector3(value, field)
    length = float(np.linalg.norm(vector))
    if not 1e-30 <= length <= 1e30:
        raise ValueError(f"{field}: expected a direction of length between 1e-30 and 1e30, got {value!r}")
    return vector


def real(value: Any) -> float:
    """``value`` as a float, NaN if it is no real number: a text or a truth value is none, nor what is masked or has a
    unit."""
    if isinstance(value, (str, bytes, bool, np.bool_)) or value is np.ma.masked or type(value).__name__ == "Quantity":
        return float("nan")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def truth(value: Any, field: str) -> bool:
    """Raise ValueError unless ``value`` is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{field}: expected True or False, got {value!r}")
    return bool(value)


def finite(value: Any, field: str) -> float:
    """Return ``value`` as a finite float, or raise ValueError naming ``field``."""
    number = real(value)
    if not np.isfinite(number):
        raise ValueError(f"{field}: expected a finite number, got {value!r}")
    return number


def unusable_vertices(
    vertices: FloatArray, triangles: npt.NDArray[np.integer[Any]] | None = None
) -> npt.NDArray[np.intp]:
    """Numbers of the vertices that a triangle uses and that are not finite or beyond :data:`LARGEST`, in order.

    What no triangle uses cannot matter to any shadow.

    Args:
        vertices: (V, 3) coordinates [m].
        triangles: (T, 3) indices, in range; None if every vertex is used.
    """
    # NaN comes out of min and max and fails the comparison.
    if not vertices.size or (vertices.min() >= -LARGEST and vertices.max() <= LARGEST):
        return np.zeros(0, np.intp)
    wrong = ~(np.abs(vertices) <= LARGEST).all(axis=1)
    if triangles is None:
        return np.flatnonzero(wrong)
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    return np.flatnonzero(wrong & used)


def rigid_pose(value: Any, field: str) -> FloatArray:
    """Return ``value`` as a 4x4 rigid transform: finite, last row 0 0 0 1, rotation orthonormal within 1e-6,
    determinant +1."""
    pose = reals(value, field, "a 4x4 rigid transform")
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
    return pose


def name_of(value: Any, field: str) -> str:
    """Return ``value`` as a non-empty string, or raise ValueError naming ``field``."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{field}: expected a non-empty string, got {value!r}")
    return value
