# SPDX-License-Identifier: Apache-2.0
"""What is asked about cones, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.area_lights import AreaLight
from shadow_tracer.scene.checks import LARGEST, FloatArray, reals
from shadow_tracer.scene.lights import Light

WIDEST = 1.5
"""Half angles beyond this [rad], 86 degrees, are refused."""
STEEPEST = math.tan(WIDEST)
"""The largest radius of an end, in parts of the length."""
MOST_HITS = 4096
# A cone that has a width has this one at least, in parts of its length: far below what its answers leave in doubt.
_LEAST_SLOPE = 1e-30
_SHORTEST = 1e-30


@dataclass(frozen=True)
class ConeArrays:
    """N cones.

    Attributes:
        shape: of what was asked, N in all.
        apices: (N, 3).
        ends: (N, 4) where their axes end: points and 1, or directions and 0 of cones without an end.
        slopes: (N,) tangents of their half angles.
    """

    shape: tuple[int, ...]
    apices: FloatArray
    ends: FloatArray
    slopes: FloatArray


def place_of(light: Light) -> FloatArray:
    """(4,) homogeneous position of a light's middle: a point and 1, or the direction to it and 0."""
    return (light.shines if isinstance(light, AreaLight) else light).homogeneous


def _points(value: Any, field: str) -> FloatArray:
    points = reals(value, field, "real numbers of shape (..., 3)")
    if points.ndim == 0 or points.shape[-1] != 3:
        raise ValueError(f"{field}: expected real numbers of shape (..., 3), got shape {points.shape}")
    if not (points.min(initial=0.0) >= -LARGEST and points.max(initial=0.0) <= LARGEST):  # NaN comes out of both
        at = tuple(int(k) for k in np.argwhere(~(np.abs(points) <= LARGEST))[0])
        raise ValueError(f"{field}: expected finite numbers of at most {LARGEST:g}, got {points[at]} at {at}")
    return points


def _sizes(value: Any, field: str, least: float, most: float) -> FloatArray:
    sizes = reals(value, field, "real numbers")
    if sizes.size and not (sizes.min() >= least and sizes.max() <= most):
        at = tuple(int(k) for k in np.argwhere(~((sizes >= least) & (sizes <= most)))[0])
        raise ValueError(f"{field}: expected numbers from {least:g} to {most:g}, got {sizes[at]} at {at}")
    return sizes


def _together(**arrays: FloatArray) -> tuple[tuple[int, ...], list[FloatArray]]:
    """Their common leading shape, and all of that shape, flat; those called apex, target or axis are points."""
    leading = {
        name: array.shape[:-1] if name in ("apex", "target", "axis") else array.shape for name, array in arrays.items()
    }
    try:
        shape = np.broadcast_shapes(*leading.values())
    except ValueError as error:
        said = ", ".join(f"{name} {some}" for name, some in leading.items())
        raise ValueError(f"apex: expected leading shapes that go together, got {said}") from error
    flat = [
        np.ascontiguousarray(np.broadcast_to(array, shape + array.shape[len(leading[name]) :])).reshape(
            -1, *array.shape[len(leading[name]) :]
        )
        for name, array in arrays.items()
    ]
    return shape, flat


def _first(wrong: npt.NDArray[np.bool_]) -> int:
    return int(np.flatnonzero(wrong)[0])


def check_cones(apex: Any, target: Any, radius: Any, half_angle: Any, length: Any) -> ConeArrays:
    """Cones with an end, or to a light.

    Raises:
        ValueError: an argument is malformed; the message names it.
    """
    if (radius is None) == (half_angle is None):
        raise ValueError("radius: expected either radius or half_angle, got " + ("none" if radius is None else "both"))
    endless = False
    if isinstance(target, Light):
        place = place_of(target)
        target, endless = place[:3], place[3] == 0.0
    if endless and length is None:
        if half_angle is None:
            raise ValueError("radius: expected half_angle for cones to a light at infinity, got radius")
        return check_axes(apex, target, half_angle)
    wide = (
        _sizes(radius, "radius", 0.0, LARGEST) if half_angle is None else _sizes(half_angle, "half_angle", 0.0, WIDEST)
    )
    arrays = {"apex": _points(apex, "apex"), "target": _points(target, "target"), "radius": wide}
    if length is not None:
        arrays["length"] = _sizes(length, "length", _SHORTEST, LARGEST)
    shape, (apices, targets, sizes, *lengths) = _together(**arrays)
    ways = targets if endless else targets - apices
    far = _lengths(ways)
    if (far < _SHORTEST).any():
        raise ValueError(f"target: expected points other than the apices, got the apex at {_first(far < _SHORTEST)}")
    if lengths:
        targets = apices + ways * (lengths[0] / far)[:, None]
        far = _lengths(targets - apices)
        wrong = ~(np.abs(far - lengths[0]) <= 1e-6 * lengths[0])
        if wrong.any():
            at = _first(wrong)
            raise ValueError(f"length: expected one that float64 can add to the apex, got {lengths[0][at]} at {at}")
    slopes = sizes / far if half_angle is None else np.tan(sizes)
    if half_angle is None and (slopes > STEEPEST).any():
        at = _first(slopes > STEEPEST)
        raise ValueError(f"radius: expected at most {STEEPEST:.1f} times the length, got {sizes[at]} at {at}")
    return ConeArrays(shape, apices, _placed(targets, 1.0), _wide(sizes, slopes))


def check_axes(apex: Any, axis: Any, half_angle: Any) -> ConeArrays:
    """Cones without an end.

    Raises:
        ValueError: an argument is malformed; the message names it.
    """
    arrays = {"apex": _points(apex, "apex"), "axis": _points(axis, "axis")}
    arrays["half_angle"] = _sizes(half_angle, "half_angle", 0.0, WIDEST)
    shape, (apices, axes, angles) = _together(**arrays)
    far = _lengths(axes)
    wrong = ~((far >= 1e-30) & (far <= 1e30))
    if wrong.any():
        raise ValueError(f"axis: expected directions of length between 1e-30 and 1e30, got {axes[_first(wrong)]}")
    return ConeArrays(shape, apices, _placed(axes, 0.0), _wide(angles, np.tan(angles)))


def _lengths(ways: FloatArray) -> FloatArray:
    x, y, z = ways.T
    squares = x * x + y * y + z * z
    if not squares.size or (squares.min() > 1e-200 and squares.max() < 1e200):
        plain: FloatArray = np.sqrt(squares)
        return plain
    most = np.abs(ways).max(axis=1)
    scaled = ways / np.where(most > 0.0, most, 1.0)[:, None]
    lengths: FloatArray = most * np.sqrt((scaled * scaled).sum(axis=1))
    return lengths


def _placed(points: FloatArray, w: float) -> FloatArray:
    """(N, 4) homogeneous points."""
    placed = np.empty((len(points), 4))
    placed[:, :3], placed[:, 3] = points, w
    return placed


def _wide(sizes: FloatArray, slopes: FloatArray) -> FloatArray:
    return np.where(sizes > 0.0, np.maximum(slopes, _LEAST_SLOPE), 0.0)


def check_count(n: Any) -> int:
    """How many triangles are asked for.

    Raises:
        ValueError: not that.
    """
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or not 1 <= n <= MOST_HITS:
        raise ValueError(f"n: expected an integer from 1 to {MOST_HITS}, got {n!r}")
    return int(n)


def check_budget(budget: Any) -> int | None:
    """Nodes and triangles that may be looked at, None: all.

    Raises:
        ValueError: not that.
    """
    if budget is None:
        return None
    if isinstance(budget, bool) or not isinstance(budget, (int, np.integer)) or budget < 1:
        raise ValueError(f"budget: expected a positive integer or None, got {budget!r}")
    return int(budget)


def check_after(after: Any, shape: tuple[int, ...]) -> tuple[FloatArray, npt.NDArray[np.int32]] | None:
    """Distance and number of the last triangle that is not asked for, of each cone.

    Raises:
        ValueError: not that.
    """
    if after is None:
        return None
    if not isinstance(after, (tuple, list)) or len(after) != 2:
        raise ValueError(f"after: expected (distances, triangles) or None, got {type(after).__name__}")
    distances = reals(after[0], "after", "distances, real numbers")
    numbers = np.asarray(after[1])
    if np.isnan(distances).any() or numbers.dtype.kind not in "iu":
        raise ValueError("after: expected distances that are not NaN, and numbers of triangles that are integers")
    try:
        pair = np.broadcast_to(distances, shape), np.broadcast_to(numbers, shape)
    except ValueError as error:
        raise ValueError(f"after: expected shape {shape}, got {distances.shape} and {numbers.shape}") from error
    # All that counts is which triangles, whose numbers are int32, have greater ones.
    return pair[0].reshape(-1), np.clip(pair[1].reshape(-1).astype(float), -1, 2**31 - 1).astype(np.int32)
