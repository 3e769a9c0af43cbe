# SPDX-License-Identifier: Apache-2.0
"""Where the points of lights with size lie: patterns without a light, made with + - * / and square roots alone, so that
they are the same float64 numbers on every machine."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from shadow_tracer.scene.checks import FloatArray

# Of the golden angle, by which each point of a spiral is turned on from the one before.
_COSINE, _SINE = -0.7373688780783197, 0.6754902942615238


def _frozen(points: FloatArray) -> FloatArray:
    points.setflags(write=False)
    return points


@cache
def lattice(count: int) -> FloatArray:
    """(count, 3) points on the unit sphere: equal steps along z, each turned on by the golden angle (a Fibonacci
    lattice). Turned by multiplication: sines differ between machines in the last bit."""
    x, y = 1.0, 0.0
    points = np.empty((count, 3))
    for k in range(count):
        z = 1.0 - (2 * k + 1) / count
        ring = math.sqrt(1.0 - z * z)
        points[k] = ring * x, ring * y, z
        x, y = x * _COSINE - y * _SINE, x * _SINE + y * _COSINE
    return _frozen(points)


@cache
def spiral(count: int) -> FloatArray:
    """(count, 2) points in the unit disc: rings of equal area, each turned on by the golden angle (Vogel 1979)."""
    x, y = 1.0, 0.0
    points = np.empty((count, 2))
    for k in range(count):
        ring = math.sqrt((2 * k + 1) / (2 * count))
        points[k] = ring * x, ring * y
        x, y = x * _COSINE - y * _SINE, x * _SINE + y * _COSINE
    return _frozen(points)


def _mirrored(count: int) -> list[float]:
    """Of each k below count the binary digits in reverse, as a number between 0 and 1 (van der Corput 1935)."""
    digits = max(1, (count - 1).bit_length())
    places = [sum((k >> digit & 1) << (digits - 1 - digit) for digit in range(digits)) for k in range(count)]
    return [(2 * place + 1) / 2 ** (digits + 1) for place in places]


@cache
def square(count: int) -> FloatArray:
    """(count, 2) points in the square from -1 to 1: a Hammersley set (1960), moved to the middle of its cells. With 64
    points, every cut of the square into 64 equal boxes of 2^-k by 2^(k - 6) has one in each, so that an edge along a
    side takes 65 shares, not the 9 of a grid of eight by eight."""
    points = [((2 * k + 1) / count - 1.0, 2.0 * other - 1.0) for k, other in enumerate(_mirrored(count))]
    return _frozen(np.array(points))


@cache
def cylinder(count: int) -> FloatArray:
    """(count, 3) points within the cylinder of radius 1 around z from -1 to 1, even as it is seen from the side: equal
    steps along z, and across the axis the points of a sphere laid flat. A sphere is even along each of its axes
    (Archimedes), so the cylinder is seen from any side as a ribbon of even brightness, as a tube is that shines alike
    in all directions of its surface (Lambert)."""
    x, y = 1.0, 0.0
    points = np.empty((count, 3))
    for k, other in enumerate(_mirrored(count)):
        height = 2.0 * other - 1.0
        ring = math.sqrt(1.0 - height * height)
        points[k] = ring * x, ring * y, (2 * k + 1) / count - 1.0
        x, y = x * _COSINE - y * _SINE, x * _SINE + y * _COSINE
    return _frozen(points)


def tangent(angle: float) -> float:
    """Of an angle from 0 to pi/4 [rad], by Lambert's continued fraction: libraries differ in the last bit."""
    square = angle * angle
    value = 25.0
    for odd in range(23, 0, -2):
        value = odd - square / value
    return angle / value


def across(x: float, y: float, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Three unit vectors at right angles: one along (x, y, z), which is not zero, and two across it."""
    largest = max(abs(x), abs(y), abs(z))
    x, y, z = x / largest, y / largest, z / largest
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    # The axis least along it, crossed with it.
    least = min(abs(x), abs(y), abs(z))
    u = (0.0, -z, y) if least == abs(x) else (z, 0.0, -x) if least == abs(y) else (-y, x, 0.0)
    length = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    a, b, c = u[0] / length, u[1] / length, u[2] / length
    v = (y * c - z * b, z * a - x * c, x * b - y * a)
    return np.array((x, y, z)), np.array((a, b, c)), np.array(v)
