# SPDX-License-Identifier: Apache-2.0
"""Lights with size, which cast soft shadows.

Each is, for the shadow test, a pattern of points (``patterns.py``) that belongs to the light and not to who looks at
it; each of them is a hard light, with an exact answer. How many of them reach a place is its visibility. A light casts
no shadow.

Where a light with size shines is decided once, for all of its points, as if it were the hard light ``shines``: by its
range from the centre and, where it shines to one side only, by which side a sample is on (as a spot light of a right
angle is asked: a sample in the plane is not in front, but for the very centre). Elsewhere a sample is OUTSIDE, and no
point of the light reaches it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from shadow_tracer.scene import patterns
from shadow_tracer.scene.checks import LARGEST, FloatArray, direction3, real, vector3
from shadow_tracer.scene.hard_lights import (
    DirectionalLight,
    HardLight,
    NamedLight,
    PointLight,
    SpotLight,
    Vector,
    freeze,
    range_of,
)
from shadow_tracer.scene.strength import ISOTROPIC, LAMBERT

MOST_BITS = 64
"""Points of a light that are told apart, as the bits of a 64-bit number."""


class AreaLight(NamedLight):
    """What lights with size have in common.

    Attributes:
        samples: number of points.
    """

    samples: int
    _quantities: ClassVar[tuple[str, ...]] = ("power", "intensity", "exitance")
    _models: ClassVar[tuple[str, ...]] = (ISOTROPIC, LAMBERT)
    _most_samples: ClassVar[int] = MOST_BITS

    def __post_init__(self) -> None:
        super().__post_init__()
        count, most = self.samples, self._most_samples
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or not 2 <= count <= most:
            raise ValueError(f"samples: expected an integer from 2 to {most}, got {count!r}")
        object.__setattr__(self, "samples", int(count))

    @property
    def homogeneous_points(self) -> FloatArray:
        """(samples, 4) each point as :attr:`PointLight.homogeneous` and :attr:`DirectionalLight.homogeneous` are."""
        raise NotImplementedError

    @property
    def shines(self) -> HardLight:
        """A hard light in the middle that shines where this one does."""
        raise NotImplementedError

    @property
    def endless(self) -> bool:
        """Whether it shines everywhere."""
        return not math.isfinite(self.shines.range) and not isinstance(self.shines, SpotLight)

    def hard_lights(self) -> list[HardLight]:
        """The points one by one."""
        at = self.homogeneous_points
        if at[0, 3] == 0.0:
            return [DirectionalLight(self.name, -point[:3]) for point in at]
        # What the centre does not reach is not asked about; so points need not reach farther than this, roundings
        # included.
        centre = self.shines.homogeneous[:3]
        extent = float(np.sqrt(((at[:, :3] - centre) ** 2).sum(axis=1).max()))
        reach = (self.shines.range + extent) * (1.0 + 1e-9) + 1e-9 * float(np.abs(centre).max())
        return [PointLight(self.name, point[:3], reach) for point in at]


class _Lamp(AreaLight):
    """A light with size that is somewhere: it shines as its middle does.

    Attributes:
        position: (3,) its middle [m].
        range: how far it reaches from there [m].
    """

    position: Vector
    range: float

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "range", range_of(self.range))

    @property
    def points(self) -> FloatArray:
        """(samples, 3) the points [m], the same bits on every machine."""
        raise NotImplementedError

    @property
    def homogeneous_points(self) -> FloatArray:
        """(samples, 4)."""
        return np.column_stack([self.points, np.ones(self.samples)])

    @property
    def shines(self) -> HardLight:
        """Its middle."""
        return PointLight(self.name, self.position, self.range)


class _Panel(_Lamp):
    """A flat lamp.

    Attributes:
        normal: (3,) the way its middle shines.
        two_sided: whether it shines the other way, too.
    """

    normal: Vector
    two_sided: bool

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.two_sided, (bool, np.bool_)):
            raise ValueError(f"two_sided: expected True or False, got {self.two_sided!r}")
        object.__setattr__(self, "two_sided", bool(self.two_sided))

    @property
    def shines(self) -> HardLight:
        """Its middle, to one side or both."""
        if self.two_sided:
            return super().shines
        return SpotLight(self.name, self.position, self.normal, 0.5 * math.pi, self.range)


def _check_radius(light: SphereLight | DiscLight) -> None:
    """Of a light whose position is checked: positive, and nowhere too far."""
    radius = real(light.radius)
    if not 0.0 < radius <= LARGEST or not (np.abs(light.position) + radius <= LARGEST).all():
        raise ValueError(f"radius: expected a positive length in metres, got {light.radius!r}")
    object.__setattr__(light, "radius", radius)


@dataclass(frozen=True, eq=False)
class SphereLight(_Lamp):
    """A glowing sphere: ``samples`` points spread evenly over its surface, each of which shines like a
    :class:`PointLight`.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) centre in the world [m].
        radius: positive [m].
        range: samples of the scene farther than this from the centre are OUTSIDE [m]; infinity by default.
        samples: number of points, 2 to 1024; those of up to 64 are told apart (:meth:`Frame.light_bits`).
        ignore, strength: as for :class:`PointLight`.
    """

    _most_samples: ClassVar[int] = 1024

    position: Vector
    radius: float
    range: float = math.inf
    samples: int = 32

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "position", vector3(self.position, "position"))
        _check_radius(self)

    @property
    def points(self) -> FloatArray:
        """(samples, 3) the points on the surface [m], the same bits on every machine."""
        return self.position + self.radius * patterns.lattice(self.samples)


@dataclass(frozen=True, eq=False)
class DiscLight(_Panel):
    """A glowing disc: ``samples`` points in it on a spiral of equal areas.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) centre in the world [m].
        normal: (3,) the way its middle shines; any length but zero.
        radius: positive [m].
        two_sided: whether it shines to both sides. Else samples behind it, and in its plane, are OUTSIDE.
        range: samples of the scene farther than this from the centre are OUTSIDE [m]; infinity by default.
        samples: number of points, 2 to 64.
        ignore, strength: as for :class:`PointLight`.
    """

    position: Vector
    normal: Vector
    radius: float
    two_sided: bool = False
    range: float = math.inf
    samples: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "position", vector3(self.position, "position"))
        freeze(self, "normal", direction3(self.normal, "normal"))
        _check_radius(self)

    @property
    def points(self) -> FloatArray:
        """(samples, 3) the points [m], the same bits on every machine."""
        _, u, v = patterns.across(*self.normal.tolist())
        a, b = (column[:, None] for column in patterns.spiral(self.samples).T)
        return self.position + a * (self.radius * u) + b * (self.radius * v)


@dataclass(frozen=True, eq=False)
class RectangleLight(_Panel):
    """A glowing rectangle: ``samples`` points in it, a Hammersley set.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) centre in the world [m].
        u, v: (3,) from the centre to the middle of a side [m], at right angles to each other; their lengths are half
            those of the sides. It shines the way of ``u x v``: the side from which u turns into v counter-clockwise.
        two_sided: whether it shines to both sides. Else samples behind it, and in its plane, are OUTSIDE.
        range: samples of the scene farther than this from the centre are OUTSIDE [m]; infinity by default.
        samples: number of points, 2 to 64.
        ignore, strength: as for :class:`PointLight`.

    Attributes:
        normal: (3,) unit vector, the way its middle shines.
    """

    position: Vector
    u: Vector
    v: Vector
    two_sided: bool = False
    range: float = math.inf
    samples: int = 64
    normal: Vector = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "position", vector3(self.position, "position"))
        freeze(self, "u", direction3(self.u, "u"))
        freeze(self, "v", direction3(self.v, "v"))
        if not abs(float(self.u @ self.v)) <= 1e-6 * float(np.linalg.norm(self.u) * np.linalg.norm(self.v)):
            raise ValueError(f"v: expected a vector at right angles to u = {self.u.tolist()}, got {self.v.tolist()}")
        (a, b, c), (x, y, z) = (patterns.across(*side.tolist())[0].tolist() for side in (self.u, self.v))
        freeze(self, "normal", np.array((b * z - c * y, c * x - a * z, a * y - b * x)))

    @property
    def points(self) -> FloatArray:
        """(samples, 3) the points [m], the same bits on every machine."""
        a, b = (column[:, None] for column in patterns.square(self.samples).T)
        return self.position + a * self.u + b * self.v


@dataclass(frozen=True, eq=False)
class TubeLight(_Lamp):
    """A glowing tube, such as a fluorescent or UV-C lamp: ``samples`` points within it, spread so that it is seen from
    every side as a ribbon of even brightness. Its ends are dark.

    Args:
        name: how the light is called in results; a non-empty string.
        start, end: (3,) ends of its axis in the world [m], at least 1e-30 m apart.
        radius: 0 or more [m]; 0 is a line.
        range: samples of the scene farther than this from the middle are OUTSIDE [m]; infinity by default.
        samples: number of points, 2 to 64.
        ignore, strength: as for :class:`PointLight`.

    Attributes:
        position: (3,) its middle [m].
    """

    start: Vector
    end: Vector
    radius: float = 0.0
    range: float = math.inf
    samples: int = 64
    position: Vector = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "start", vector3(self.start, "start"))
        freeze(self, "end", vector3(self.end, "end"))
        radius = real(self.radius)
        if not 0.0 <= radius <= LARGEST or not (np.abs([self.start, self.end]) + radius <= LARGEST).all():
            raise ValueError(f"radius: expected a length in metres that is not negative, got {self.radius!r}")
        object.__setattr__(self, "radius", radius)
        if not np.abs(self.end - self.start).max() >= 1e-30:
            raise ValueError(f"end: expected another place than start = {self.start.tolist()}, got {self.end.tolist()}")
        freeze(self, "position", 0.5 * self.start + 0.5 * self.end)
        if not radius and self.strength is not None and self.strength.exitance is not None:
            raise ValueError("strength.exitance: a tube of radius 0 has no surface; give power or intensity")

    @property
    def points(self) -> FloatArray:
        """(samples, 3) the points [m], the same bits on every machine."""
        half = 0.5 * self.end - 0.5 * self.start
        _, u, v = patterns.across(*half.tolist())
        a, b, along = (column[:, None] for column in patterns.cylinder(self.samples).T)
        return self.position + along * half + a * (self.radius * u) + b * (self.radius * v)


@dataclass(frozen=True, eq=False)
class SunDisc(AreaLight):
    """A round light infinitely far away, such as the sun with its disc: ``samples`` directions on a spiral of equal
    areas, each of which shines like a :class:`DirectionalLight`.

    Args:
        name: how the light is called in results; a non-empty string.
        direction: (3,) the way the light of its middle travels; any length but zero.
        angular_diameter: of the disc [rad], 0 < angular_diameter <= pi/2; by default that of the sun, 0.533 degrees.
        samples: number of directions, 2 to 64.
        ignore, strength: as for :class:`PointLight`; its strength is the ``irradiance`` of the whole disc on a plane at
            right angles to its middle.
    """

    _quantities: ClassVar[tuple[str, ...]] = ("irradiance",)
    _models: ClassVar[tuple[str, ...]] = ()

    direction: Vector
    angular_diameter: float = math.radians(0.533)
    samples: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "direction", direction3(self.direction, "direction"))
        angle = real(self.angular_diameter)
        if not 0.0 < angle <= 0.5 * math.pi:
            raise ValueError(
                f"angular_diameter: expected an angle in radians with 0 < angle <= pi/2, got {self.angular_diameter!r}"
            )
        object.__setattr__(self, "angular_diameter", angle)

    @property
    def range(self) -> float:
        """It reaches everywhere: infinity."""
        return math.inf

    @property
    def directions(self) -> FloatArray:
        """(samples, 3) the ways the light of its points travels, the same bits on every machine: the middle one of
        length 1, the others longer, with their ends in a plane."""
        forward, u, v = patterns.across(*self.direction.tolist())
        radius = patterns.tangent(0.5 * self.angular_diameter)
        a, b = (column[:, None] for column in patterns.spiral(self.samples).T)
        return forward + a * (radius * u) + b * (radius * v)

    @property
    def homogeneous_points(self) -> FloatArray:
        """(samples, 4) points at infinity."""
        return np.column_stack([-self.directions, np.zeros(self.samples)])

    @property
    def shines(self) -> HardLight:
        """Its middle."""
        return DirectionalLight(self.name, self.direction)
