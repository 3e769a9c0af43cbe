# SPDX-License-Identifier: Apache-2.0
"""Lights, and what each means geometrically.

Every hard light is, for the shadow test, one homogeneous point ``(x, y, z, w)``: a position with w = 1, or the
direction *to* the light with w = 0 when it is infinitely far away; a sphere light is many. ``direction`` is always the
way light travels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from shadow_tracer.scene.checks import LARGEST, FloatArray, direction3, name_of, real, vector3

# Three real numbers in any form going in, a read-only float64 array coming out.
Vector = Any


def _unit(direction: FloatArray) -> FloatArray:
    return direction / np.linalg.norm(direction)


def _range(value: Any) -> float:
    distance = real(value)
    if not distance > 0.0:
        raise ValueError(f"range: expected a positive distance in metres or infinity, got {value!r}")
    return distance


def _freeze(light: Any, field: str, vector: FloatArray) -> None:
    vector.setflags(write=False)
    object.__setattr__(light, field, vector)


@dataclass(frozen=True, eq=False)
class PointLight:
    """A point that shines in all directions.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) position in the world [m].
        range: samples farther than this are OUTSIDE [m]; infinity by default.
    """

    name: str
    position: Vector
    range: float = math.inf

    def __post_init__(self) -> None:
        name_of(self.name, "name")
        _freeze(self, "position", vector3(self.position, "position"))
        object.__setattr__(self, "range", _range(self.range))

    @property
    def homogeneous(self) -> FloatArray:
        """(4,) homogeneous position: (x, y, z, 1)."""
        return np.append(self.position, 1.0)

    @property
    def cone(self) -> tuple[FloatArray, float]:
        """Axis and cosine of the half angle of the lit cone; a point light has none (cosine -2 admits everything)."""
        return np.array([0.0, 0.0, 1.0]), -2.0


@dataclass(frozen=True, eq=False)
class SpotLight:
    """A point that shines into a cone.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) apex of the cone [m].
        direction: (3,) axis of the cone, the way light travels; any length but zero.
        outer_angle: half angle of the cone [rad], 0 < outer_angle <= pi. Samples outside it are OUTSIDE.
        range: samples farther than this are OUTSIDE [m]; infinity by default.
    """

    name: str
    position: Vector
    direction: Vector
    outer_angle: float
    range: float = math.inf

    def __post_init__(self) -> None:
        name_of(self.name, "name")
        _freeze(self, "position", vector3(self.position, "position"))
        _freeze(self, "direction", direction3(self.direction, "direction"))
        angle = real(self.outer_angle)
        if not 0.0 < angle <= math.pi:
            raise ValueError(
                f"outer_angle: expected a half angle in radians with 0 < angle <= pi, got {self.outer_angle!r}"
            )
        object.__setattr__(self, "outer_angle", angle)
        object.__setattr__(self, "range", _range(self.range))

    @property
    def homogeneous(self) -> FloatArray:
        """(4,) homogeneous position: (x, y, z, 1)."""
        return np.append(self.position, 1.0)

    @property
    def cone(self) -> tuple[FloatArray, float]:
        """Unit axis and cosine of the half angle of the lit cone."""
        # At pi the cone is all of space; rounding of the cosine must not cut out the direction straight behind.
        cosine = -2.0 if self.outer_angle >= math.pi else math.cos(self.outer_angle)
        return _unit(self.direction), cosine


@dataclass(frozen=True, eq=False)
class DirectionalLight:
    """A light infinitely far away, such as the sun.

    Args:
        name: how the light is called in results; a non-empty string.
        direction: (3,) the way light travels; any length but zero.
    """

    name: str
    direction: Vector

    def __post_init__(self) -> None:
        name_of(self.name, "name")
        _freeze(self, "direction", direction3(self.direction, "direction"))

    @property
    def range(self) -> float:
        """A directional light reaches everywhere: infinity."""
        return math.inf

    @property
    def homogeneous(self) -> FloatArray:
        """(4,) point at infinity: (-direction, 0). Not normalised, which would turn it by a rounding error."""
        return np.append(-self.direction, 0.0)

    @property
    def cone(self) -> tuple[FloatArray, float]:
        """Axis and cosine of the half angle of the lit cone; a directional light has none."""
        return np.array([0.0, 0.0, 1.0]), -2.0


@dataclass(frozen=True, eq=False)
class SphereLight:
    """A glowing sphere, which casts soft shadows: ``samples`` points spread evenly over its surface, each of which
    shines like a :class:`PointLight`. How many of them reach a place is its visibility. The sphere casts no shadow.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) centre in the world [m].
        radius: positive [m].
        range: samples of the scene farther than this from the centre are OUTSIDE [m]; infinity by default.
        samples: number of points, 2 to 1024.
    """

    name: str
    position: Vector
    radius: float
    range: float = math.inf
    samples: int = 32

    def __post_init__(self) -> None:
        name_of(self.name, "name")
        _freeze(self, "position", vector3(self.position, "position"))
        radius = real(self.radius)
        if not 0.0 < radius <= LARGEST or not (np.abs(self.position) + radius <= LARGEST).all():
            raise ValueError(f"radius: expected a positive length in metres, got {self.radius!r}")
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "range", _range(self.range))
        count = self.samples
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or not 2 <= count <= 1024:
            raise ValueError(f"samples: expected an integer from 2 to 1024, got {count!r}")
        object.__setattr__(self, "samples", int(count))

    @property
    def points(self) -> FloatArray:
        """(samples, 3) the points on the surface [m], the same bits on every machine."""
        return self.position + self.radius * _lattice(self.samples)


@cache
def _lattice(count: int) -> FloatArray:
    """(count, 3) points on the unit sphere: equal steps along z, each turned on by the golden angle (a Fibonacci
    lattice). Turned by multiplication: sines differ between machines in the last bit."""
    cosine, sine = -0.7373688780783197, 0.6754902942615238
    x, y = 1.0, 0.0
    points = np.empty((count, 3))
    for k in range(count):
        z = 1.0 - (2 * k + 1) / count
        ring = math.sqrt(1.0 - z * z)
        points[k] = ring * x, ring * y, z
        x, y = x * cosine - y * sine, x * sine + y * cosine
    points.setflags(write=False)
    return points


HardLight = PointLight | SpotLight | DirectionalLight
"""What casts hard shadows: one homogeneous point."""
Light = HardLight | SphereLight
