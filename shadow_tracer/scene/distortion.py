# SPDX-License-Identifier: Apache-2.0
"""Rays of the pixels of a distorted image, by the distortion models of ROS (sensor_msgs/distortion_models.hpp).

Positions are in the plane z = 1 of the optical frame: a point (x, y, 1) is seen at the pixel (fx xd + cx, fy yd + cy).
``plumb_bob`` and ``rational_polynomial``, with s = x^2 + y^2:

    f  = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)
    xd = x f + 2 p1 x y + p2 (s + 2 x^2) + s1 s + s2 s^2
    yd = y f + p1 (s + 2 y^2) + 2 p2 x y + s3 s + s4 s^2

``equidistant``, with theta the angle between ray and axis: (xd, yd) = (x, y) / tan(theta) * theta (1 + k1 theta^2 + k2
theta^4 + k3 theta^6 + k4 theta^8).

The inverse is found by Newton's method in float64, started at the inverse of the radial part. Put into the model again
it gives the pixel within ``ERROR`` (1 + R), R being the largest |(xd, yd)| of the image. It exists and is the only one
where the radial part grows, up to the first zero of its derivative, a root of a polynomial, and where the symmetric
part of the Jacobian is positive definite: in a convex region of such points (a - b) . (d(a) - d(b)) > 0 for any two. A
model is refused for which the first does not hold at all pixels, or the second on the ways from the axis to the border
of the image, of which ``_ON_THE_WAY`` points are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.polynomial import polynomial

from shadow_tracer.scene.checks import FloatArray, real

COUNTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
"""Models and the numbers of coefficients they take."""
ERROR = 1e-12
"""Bound of the inverse's error in the plane z = 1."""

_LARGEST = 1e9
_STEPS = 4096
_ITERATIONS = 20
_ON_THE_WAY = 32
_BLOCK = 16384  # pixels: what is computed on the way stays in the cache


def checked_coefficients(model: Any, d: Any) -> tuple[float, ...]:
    """Coefficients of a model, in the order of OpenCV: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, or k1 k2 k3 k4.

    Raises:
        ValueError: the model is none of ``COUNTS``, or their number or a value is wrong; the message names
            ``distortion_model`` or ``d``.
    """
    if not isinstance(model, str) or model not in COUNTS:
        raise ValueError(f"distortion_model: expected one of {', '.join(COUNTS)}, got {model!r}")
    try:
        values = [real(value) for value in d]
    except TypeError as error:
        raise ValueError(f"d: expected a sequence of numbers, got {type(d).__name__}") from error
    counts = COUNTS[model]
    if len(values) not in counts:
        expected = " or ".join(map(str, counts))
        raise ValueError(f"d: expected {expected} coefficients of {model}, got {len(values)}")
    if not all(abs(value) <= _LARGEST for value in values):  # comparisons with NaN are false
        raise ValueError(f"d: expected finite numbers of at most {_LARGEST:g}, got {values}")
    if any(values[12:]):
        raise ValueError(
            f"d: expected no tilt of the sensor, tau_x = tau_y = 0 in d[12] and d[13], got {values[12:]}; rectify the "
            "image instead"
        )
    return tuple(values[:12])


def undistorted_rays(
    model: Any, d: Any, size: tuple[int, int], focal: tuple[float, float], centre: tuple[float, float]
) -> FloatArray | None:
    """x and y at z = 1 of the rays of all pixels.

    Args:
        model: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
        d: its coefficients, see :func:`checked_coefficients`.
        size: width and height [px].
        focal: fx and fy [px].
        centre: cx and cy [px].

    Returns:
        (height, width, 2) float64, NaN where a ray is 90 degrees or more from the axis, as those of ``equidistant`` may
        be. None: there is no distortion, ``plumb_bob`` and ``rational_polynomial`` with zeros alone.

    Raises:
        ValueError: as :func:`checked_coefficients`, or the model cannot be inverted in the image.
    """
    values = checked_coefficients(model, d)
    if model != "equidistant" and not any(values):
        return None
    x = (np.arange(size[0], dtype=np.float64) - centre[0]) / focal[0]
    y = (np.arange(size[1], dtype=np.float64) - centre[1]) / focal[1]
    rays = np.empty((size[1], size[0], 2))
    invert = _Equidistant(values) if model == "equidistant" else _Polynomial(values)
    farthest = float(np.hypot(np.abs(x).max(), np.abs(y).max()))
    with np.errstate(all="ignore"):  # what leaves float64 is not finite, and refused
        invert.reach(farthest)
        rows = max(1, _BLOCK // size[0])
        good = True
        for first in range(0, size[1], rows):
            here = rays[first : first + rows]
            here[..., 0], here[..., 1], good = invert(*np.broadcast_arrays(x, y[first : first + rows, None]))
            if not good:
                break
        good = good and invert.leads_to(_border(rays))
    if not good:
        raise ValueError(
            f"d: expected coefficients of {model} that give every pixel one ray, got {list(values)}, with which the "
            "image folds; calibrate the camera with fewer coefficients, or rectify the image"
        )
    return rays


def _border(rays: FloatArray) -> FloatArray:
    """(N, 2) rays of the outermost pixels."""
    return np.concatenate([rays[0], rays[-1], rays[:, 0], rays[:, -1]])


class _Radial:
    """An increasing function of a radius from 0 on, tabulated, to begin its inversion with."""

    def __init__(self, function: Any, end: float) -> None:
        self._function, self._end = function, end
        self._at = self._values = np.zeros(0)

    def reach(self, value: float) -> None:
        """Tabulate it up to ``value``, or to the end."""
        high = min(value, self._end)
        for _ in range(64):
            if high == self._end or self._function(high) > 1.1 * value:
                break
            high = min(2.0 * high, self._end)
        self._at = np.linspace(0.0, high, _STEPS)
        self._values = self._function(self._at)

    def inverse(self, values: FloatArray) -> FloatArray:
        """Roughly; beyond the end the end."""
        found: FloatArray = np.interp(values, self._values, self._at)
        return found


class _Polynomial:
    """Inverts ``plumb_bob`` and ``rational_polynomial``."""

    def __init__(self, d: Sequence[float]) -> None:
        k1, k2, self._p1, self._p2, k3, k4, k5, k6, *prism = [*d, *[0.0] * (12 - len(d))]
        self._prism = prism
        over, under = np.array([1.0, k1, k2, k3]), np.array([1.0, k4, k5, k6])
        self._over, self._under, self._scale = over, under, 1.0
        slope = polynomial.polysub(
            polynomial.polymul(polynomial.polyder(over), under), polynomial.polymul(over, polynomial.polyder(under))
        )
        self._slope = slope  # of f, times the square of what it is divided by
        grows = polynomial.polyadd(polynomial.polymul(over, under), 2.0 * polynomial.polymulx(slope))
        self._end = min(_first_root(grows), _first_root(under))
        self._radial = _Radial(lambda r: r * _value(over, r * r) / _value(under, r * r), math.sqrt(self._end))

    def reach(self, farthest: float) -> None:
        """Get ready for positions up to this distance from the axis."""
        self._scale = 1.0 + farthest
        self._radial.reach(farthest)

    def distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
        """xd, yd, and the Jacobian row by row."""
        p1, p2, (s1, s2, s3, s4) = self._p1, self._p2, self._prism
        xx, yy, xy = x * x, y * y, x * y
        s = xx + yy
        under = _value(self._under, s)
        f, slope = _value(self._over, s) / under, 2.0 * _value(self._slope, s) / (under * under)
        xd = x * f + 2.0 * p1 * xy + p2 * (s + 2.0 * xx)
        yd = y * f + p1 * (s + 2.0 * yy) + 2.0 * p2 * xy
        across = slope * xy + 2.0 * (p1 * x + p2 * y)
        x_x, x_y = f + slope * xx + 2.0 * p1 * y + 6.0 * p2 * x, across
        y_x, y_y = across, f + slope * yy + 6.0 * p1 * y + 2.0 * p2 * x
        if any(self._prism):
            of_x, of_y = 2.0 * (s1 + 2.0 * s2 * s), 2.0 * (s3 + 2.0 * s4 * s)
            xd, yd = xd + s * (s1 + s2 * s), yd + s * (s3 + s4 * s)
            x_x, x_y, y_x, y_y = x_x + x * of_x, x_y + y * of_x, y_x + x * of_y, y_y + y * of_y
        return xd, yd, x_x, x_y, y_x, y_y

    def __call__(self, xd: FloatArray, yd: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
        """x and y of what is seen at ``xd``, ``yd``, and whether that is right."""
        r = np.hypot(xd, yd)
        scale = np.divide(self._radial.inverse(r), r, out=np.ones_like(r), where=r > 0.0)
        x, y = xd * scale, yd * scale
        best = math.inf
        for _ in range(_ITERATIONS):
            at_x, at_y, x_x, x_y, y_x, y_y = self.distort(x, y)
            off_x, off_y = at_x - xd, at_y - yd
            off = max(float(np.abs(off_x).max()), float(np.abs(off_y).max()))
            if not off < 0.5 * best:  # rounding is all that is left; or it is NaN
                break
            best, found = off, (x, y)
            if off <= 1e-16 * self._scale:
                break
            determinant = x_x * y_y - x_y * y_x
            x, y = x - (y_y * off_x - x_y * off_y) / determinant, y - (x_x * off_y - y_x * off_x) / determinant
        if not best <= ERROR * self._scale:
            return x, y, False
        x, y = found
        return x, y, bool((x * x + y * y < self._end).all())

    def leads_to(self, border: FloatArray) -> bool:
        """Whether nothing folds on the ways from the axis to the rays of the border, and so in the whole image."""
        ways = np.linspace(0.0, 1.0, _ON_THE_WAY)[:, None, None] * border
        _, _, x_x, x_y, y_x, y_y = self.distort(ways[..., 0], ways[..., 1])
        return bool(((x_x + y_y > 0.0) & (x_x * y_y > 0.25 * (x_y + y_x) ** 2)).all())


class _Equidistant:
    """Inverts ``equidistant``."""

    def __init__(self, d: Sequence[float]) -> None:
        self._d = d
        self._slope = np.array([1.0, *(d[k] * (2 * k + 3) for k in range(4))])  # of theta_d, in theta^2
        self._end = min(math.sqrt(_first_root(self._slope)), 0.5 * math.pi)
        self._theta_d = _theta_d(d)
        self._radial = _Radial(self._theta_d, self._end)
        self._scale = 1.0

    def reach(self, farthest: float) -> None:
        """Get ready for positions up to this distance from the axis."""
        self._scale = 1.0 + farthest
        self._radial.reach(farthest)

    def __call__(self, xd: FloatArray, yd: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
        """x and y of what is seen at ``xd``, ``yd``, and whether that is right."""
        r = np.hypot(xd, yd)
        ahead = r < self._theta_d(0.5 * math.pi) if self._end == 0.5 * math.pi else np.ones(r.shape, np.bool_)
        wanted = np.where(ahead, r, 0.0)
        theta = self._radial.inverse(wanted)
        for _ in range(4):  # Newton's; the table is good to six digits
            off = self._theta_d(theta) - wanted
            theta = np.minimum(theta - off / _value(self._slope, theta * theta), self._end)
        off = np.abs(self._theta_d(theta) - wanted)
        good = off <= ERROR * self._scale
        scale = np.divide(np.tan(theta), r, out=np.ones_like(r), where=r > 0.0)
        scale[~ahead] = np.nan
        return xd * scale, yd * scale, bool(good.all())

    def leads_to(self, border: FloatArray) -> bool:
        """True: a function of one number has been inverted from 0 on."""
        return True


def _theta_d(d: Sequence[float]) -> Any:
    return lambda theta: theta * _value(np.array([1.0, *d]), theta * theta)


def _value(coefficients: FloatArray, s: Any) -> Any:
    """A polynomial, the constant first."""
    total = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = total * s + coefficient
    return total


def _first_root(coefficients: FloatArray) -> float:
    """The least positive root of a polynomial, infinity if there is none."""
    # Coefficients that no image is wide enough for would overflow the search.
    roots = polynomial.polyroots(np.trim_zeros(np.where(np.abs(coefficients) < 1e-150, 0.0, coefficients), "b"))
    positive = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    return float(positive.min(initial=math.inf))
