# SPDX-License-Identifier: Apache-2.0
"""Lights without size, and what each means geometrically.

Each is, for the shadow test, one homogeneous point ``(x, y, z, w)``: a position with w = 1, or the direction *to* the
light with w = 0 when it is infinitely far away. ``direction`` is always the way light travels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from shadow_tracer.scene.checks import FloatArray, direction3, name_of, real, vector3
from shadow_tracer.scene.strength import ISOTROPIC, LAMBERT, Strength, check_strength

# Three real numbers in any form going in, a read-only float64 array coming out.
Vector = Any


def _unit(direction: FloatArray) -> FloatArray:
    return direction / np.linalg.norm(direction)


def range_of(value: Any) -> float:
    """A positive distance, or ValueError."""
    distance = real(value)
    if not distance > 0.0:
        raise ValueError(f"range: expected a positive distance in metres or infinity, got {value!r}")
    return distance


def freeze(light: Any, name: str, vector: FloatArray) -> None:
    """Set a field to a vector that is not to be written to."""
    vector.setflags(write=False)
    object.__setattr__(light, name, vector)


def names_of(value: Any) -> tuple[str, ...]:
    """Different names of meshes in ascending order, whatever iterable they come in. Raises ValueError."""
    hint = "ignore: expected an iterable of names of meshes"
    if isinstance(value, str):
        raise ValueError(f"{hint}, got the text {value!r}; write [{value!r}]")
    if not isinstance(value, Iterable):
        raise ValueError(f"{hint}, got {value!r}")
    return tuple(sorted({name_of(name, f"ignore[{index}]") for index, name in enumerate(value)}))


@dataclass(frozen=True, eq=False)
class NamedLight:
    """What all lights have in common, and the check of it."""

    name: str
    ignore: Iterable[str] = field(default=(), kw_only=True)
    strength: Strength | None = field(default=None, kw_only=True)
    _quantities: ClassVar[tuple[str, ...]] = ("power", "intensity")
    _models: ClassVar[tuple[str, ...]] = (ISOTROPIC,)

    def __post_init__(self) -> None:
        name_of(self.name, "name")
        object.__setattr__(self, "ignore", names_of(self.ignore))
        check_strength(self, self._quantities, self._models)


@dataclass(frozen=True, eq=False)
class PointLight(NamedLight):
    """A point that shines in all directions.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) position in the world [m].
        range: samples farther than this are OUTSIDE [m]; infinity by default.
        ignore: names of meshes that cast no shadow in this light, such as its fixture; a name stands also for all that
            begin with it and a slash. One that no mesh has ignores nothing, until there is such a mesh.
        strength: how much it radiates, see :class:`Strength`; None: only what it reaches can be asked.
    """

    position: Vector
    range: float = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "position", vector3(self.position, "position"))
        object.__setattr__(self, "range", range_of(self.range))

    @property
    def homogeneous(self) -> FloatArray:
        """(4,) homogeneous position: (x, y, z, 1)."""
        return np.append(self.position, 1.0)

    @property
    def cone(self) -> tuple[FloatArray, float]:
        """Axis and cosine of the half angle of the lit cone; a point light has none (cosine -2 admits everything)."""
        return np.array([0.0, 0.0, 1.0]), -2.0


@dataclass(frozen=True, eq=False)
class SpotLight(NamedLight):
    """A point that shines into a cone.

    Args:
        name: how the light is called in results; a non-empty string.
        position: (3,) apex of the cone [m].
        direction: (3,) axis of the cone, the way light travels; any length but zero.
        outer_angle: half angle of the cone [rad], 0 < outer_angle <= pi. Samples outside it are OUTSIDE.
        range: samples farther than this are OUTSIDE [m]; infinity by default.
        ignore, strength: as for :class:`PointLight`.
    """

    _models: ClassVar[tuple[str, ...]] = (ISOTROPIC, LAMBERT)

    position: Vector
    direction: Vector
    outer_angle: float
    range: float = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "position", vector3(self.position, "position"))
        freeze(self, "direction", direction3(self.direction, "direction"))
        angle = real(self.outer_angle)
        if not 0.0 < angle <= math.pi:
            raise ValueError(
                f"outer_angle: expected a half angle in radians with 0 < angle <= pi, got {self.outer_angle!r}"
            )
        object.__setattr__(self, "outer_angle", angle)
        object.__setattr__(self, "range", range_of(self.range))

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
class DirectionalLight(NamedLight):
    """A light infinitely far away, such as the sun.

    Args:
        name: how the light is called in results; a non-empty string.
        direction: (3,) the way light travels; any length but zero.
        ignore, strength: as for :class:`PointLight`; its strength is an ``irradiance``.
    """

    _quantities: ClassVar[tuple[str, ...]] = ("irradiance",)
    _models: ClassVar[tuple[str, ...]] = ()

    direction: Vector

    def __post_init__(self) -> None:
        super().__post_init__()
        freeze(self, "direction", direction3(self.direction, "direction"))

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


HardLight = PointLight | SpotLight | DirectionalLight
"""What casts hard shadows: one homogeneous point."""
