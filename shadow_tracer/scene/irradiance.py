# SPDX-License-Identifier: Apache-2.0
"""What a light radiates, as numbers that its irradiance is computed from (``gpu/visibility/irradiance.py``)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from shadow_tracer.scene.area_lights import MOST_BITS, AreaLight, DiscLight, RectangleLight, SphereLight, TubeLight
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.hard_lights import SpotLight
from shadow_tracer.scene.intensity_table import IntensityTable
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.patterns import across
from shadow_tracer.scene.strength import ISOTROPIC, LAMBERT, Strength

LAWS = ALIKE, SPOT, ENDLESS, TABLE, LINE, DISC, RECTANGLE, SPHERE = (
    ("alike", "spot", "endless", "table", "line", "disc", "rectangle", "sphere")
)  # fmt: skip
_DISC_CORNERS = 64


def _vector() -> FloatArray:
    return np.zeros(3)


def _vectors() -> FloatArray:
    return np.zeros((0, 3))


def _numbers() -> FloatArray:
    return np.zeros(0)


def _table() -> FloatArray:
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class Law:
    """How a light's irradiance is computed.

    Attributes:
        kind: number in ``LAWS``: every point alike in all directions; a spot with the cosine to its direction; at
            infinity; a table; a line; a Lambertian disc, rectangle and sphere.
        scale: factor of what geometry says: W/sr of each point, W/m2/sr of a disc, rectangle or sphere, W/m/sr of a
            line, 1 of what is at infinity or a table.
        count: how many points there are.
        points: (K, 3) where they are, of what is at infinity unit vectors to them; of a line none are needed.
        weights: (K,) of what is at infinity: W/m2 of a surface that faces the point.
        centre, axis: of a disc, rectangle or sphere, and its unit normal; start and unit direction of a line; the
            direction of a spot, or of a table where its vertical angle is 0.
        radius, length: of a disc, sphere or line [m].
        corners: (C, 3) of a rectangle, or of the polygon that stands for a disc.
        lambert, two_sided: of a line; of a disc or rectangle.
        zero, side, vertical, horizontal, values: of a table: the directions of horizontal angles 0 and 90 degrees,
            (V,) and (H,) angles [rad], (H, V) W/sr of each point.
    """

    kind: int
    scale: float
    count: int = 1
    points: FloatArray = field(default_factory=_vectors)
    weights: FloatArray = field(default_factory=_numbers)
    centre: FloatArray = field(default_factory=_vector)
    axis: FloatArray = field(default_factory=_vector)
    radius: float = 0.0
    length: float = 0.0
    corners: FloatArray = field(default_factory=_vectors)
    lambert: bool = False
    two_sided: bool = False
    zero: FloatArray = field(default_factory=_vector)
    side: FloatArray = field(default_factory=_vector)
    vertical: FloatArray = field(default_factory=_numbers)
    horizontal: FloatArray = field(default_factory=_numbers)
    values: FloatArray = field(default_factory=_table)


def check_strengths(lights: tuple[Light, ...]) -> None:
    """Raise ValueError unless all lights have a strength, and points that are told apart."""
    for light in lights:
        if light.strength is None:
            raise ValueError(
                f"strength: the light {light.name!r} has none, so there is no irradiance; give it "
                "strength=Strength(power=...) [W], intensity [W/sr], exitance or irradiance [W/m2]"
            )
        if isinstance(light, AreaLight) and light.samples > MOST_BITS:
            raise ValueError(
                f"samples: expected at most {MOST_BITS} points, which are told apart, for irradiance, got the light "
                f"{light.name!r} with {light.samples}"
            )


def normals_of(value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Normals of a leading ``shape`` as (N, 3) float64, of whatever length; masked ones are NaN.

    Raises:
        ValueError: another shape, or not real numbers.
    """
    try:
        normals = np.asarray(value.filled(np.nan) if isinstance(value, np.ma.MaskedArray) else value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"normals: expected shape {(*shape, 3)}, got {type(value).__name__}") from error
    if normals.shape != (*shape, 3) or normals.dtype.kind not in "fiu":
        raise ValueError(
            f"normals: expected real numbers of shape {(*shape, 3)}, got shape {normals.shape} of {normals.dtype}"
        )
    return np.ascontiguousarray(normals.reshape(-1, 3), np.float64)


def model_of(light: Light) -> str | IntensityTable:
    """How a light's intensity falls with the angle, where its strength leaves that open too."""
    assert light.strength is not None
    return light.strength.model or (LAMBERT if isinstance(light, AreaLight) else ISOTROPIC)


def area_of(light: Light) -> float:
    """Surface that shines [m2]: of both sides of what is two-sided."""
    if isinstance(light, SphereLight):
        return 4.0 * math.pi * light.radius**2
    if isinstance(light, DiscLight):
        return math.pi * light.radius**2 * (1 + light.two_sided)
    if isinstance(light, RectangleLight):
        return 4.0 * float(np.linalg.norm(light.u) * np.linalg.norm(light.v)) * (1 + light.two_sided)
    if isinstance(light, TubeLight):
        return 2.0 * math.pi * light.radius * float(np.linalg.norm(light.end - light.start))
    raise ValueError(f"light: a {type(light).__name__} has no surface")


def _solid_angle(light: Light, model: str) -> float:
    """Power [W] over largest intensity [W/sr]."""
    if isinstance(light, SpotLight):
        angle = min(light.outer_angle, 0.5 * math.pi) if model == LAMBERT else 0.5 * light.outer_angle
        return math.pi * math.sin(angle) ** 2 * (1.0 if model == LAMBERT else 4.0)
    if isinstance(light, (DiscLight, RectangleLight)):
        return (math.pi if model == LAMBERT else 2.0 * math.pi) * (1 + light.two_sided)
    if isinstance(light, TubeLight) and model == LAMBERT:
        return math.pi**2
    return 4.0 * math.pi


def _watts(light: Light, strength: Strength) -> float:
    """Radiant power at full output."""
    model = model_of(light)
    if strength.quantity == "power":
        return strength.value()
    if strength.quantity == "exitance":
        return strength.value() * area_of(light)
    if isinstance(model, IntensityTable):
        return model.power * (strength.value() / model.peak if strength.quantity else 1.0)
    return strength.value() * _solid_angle(light, model)


def power_of(light: Light) -> float:
    """Radiant power of a light as it is now, ``output`` included [W].

    Raises:
        ValueError: it has no strength, or is infinitely far away.
    """
    if light.strength is None or light.strength.quantity == "irradiance":
        raise ValueError(f"light: expected one with a strength that is not infinitely far away, got {light.name!r}")
    return _watts(light, light.strength) * light.strength.output


def law_of(light: Light) -> Law:
    """Of a light that has a strength."""
    strength = light.strength
    assert strength is not None
    if strength.quantity == "irradiance":
        return _endless(light, strength)
    watts = _watts(light, strength) * strength.output
    model = model_of(light)
    if isinstance(light, TubeLight) and not isinstance(model, IntensityTable):
        return _line(light, model, watts)
    if model == LAMBERT and isinstance(light, (DiscLight, RectangleLight, SphereLight)):
        return _surface(light, watts / (math.pi * area_of(light)))
    at = light.homogeneous_points if isinstance(light, AreaLight) else light.homogeneous[None]
    places = Law(LAWS.index(ALIKE), 1.0 / len(at), len(at), at[:, :3])
    if isinstance(model, IntensityTable):
        scaled = model.values * (watts / model.power)
        return replace(
            places, kind=LAWS.index(TABLE), axis=model.axis, zero=model.zero, side=np.cross(-model.axis, model.zero),
            vertical=model.vertical, horizontal=model.horizontal, values=scaled,
        )  # fmt: skip
    intensity = watts / _solid_angle(light, model) / len(at)
    if model == LAMBERT and isinstance(light, SpotLight):
        return replace(places, kind=LAWS.index(SPOT), scale=intensity, axis=light.cone[0])
    return replace(places, scale=intensity)


def _endless(light: Light, strength: Strength) -> Law:
    if isinstance(light, AreaLight):
        ways = -light.homogeneous_points[:, :3]
        # Points are spread evenly over a plane across the middle, whose parts span less the farther they are out.
        weights = 1.0 / np.sqrt((ways * ways).sum(axis=1)) ** 3
        middle = light.shines.homogeneous[:3]
        middle = -middle / math.sqrt(float(middle @ middle))
    else:
        ways, weights = -light.homogeneous[None, :3], np.ones(1)
        middle = ways[0] / math.sqrt(float(ways[0] @ ways[0]))
    ways = ways / np.sqrt((ways * ways).sum(axis=1, keepdims=True))
    weights = strength.value() * strength.output * weights / float((weights * (ways @ middle)).sum())
    return Law(LAWS.index(ENDLESS), 1.0, len(ways), ways, weights)


def _line(light: TubeLight, model: str, watts: float) -> Law:
    """Each point stands for a piece of the axis; pieces have closed forms."""
    length = float(np.linalg.norm(light.end - light.start))
    lambert = model == LAMBERT
    scale = watts / length / (math.pi**2 if lambert else 4.0 * math.pi)
    axis = (light.end - light.start) / length
    return Law(
        LAWS.index(LINE), scale, light.samples, centre=light.start, axis=axis, radius=light.radius, length=length,
        lambert=lambert,
    )  # fmt: skip


def _surface(light: DiscLight | RectangleLight | SphereLight, radiance: float) -> Law:
    """Of even radiance [W/m2/sr]: the whole in closed form, times the part that the points say."""
    law = Law(LAWS.index(SPHERE), radiance, light.samples, light.points, centre=light.position)
    if isinstance(light, SphereLight):
        return replace(law, radius=light.radius)
    normal = light.normal / math.sqrt(float(light.normal @ light.normal))
    law = replace(law, axis=normal, two_sided=light.two_sided)
    if isinstance(light, RectangleLight):
        corners = light.position + np.array([[1, 1], [-1, 1], [-1, -1], [1, -1.0]]) @ np.stack([light.u, light.v])
        return replace(law, kind=LAWS.index(RECTANGLE), corners=corners)
    _, x, y = across(*normal.tolist())
    turn = np.arange(_DISC_CORNERS)[:, None] * (2.0 * math.pi / _DISC_CORNERS)
    corner = light.radius * math.sqrt(2.0 * math.pi / (_DISC_CORNERS * math.sin(2.0 * math.pi / _DISC_CORNERS)))
    rim = light.position + corner * (np.cos(turn) * x + np.sin(turn) * y)
    return replace(law, kind=LAWS.index(DISC), radius=light.radius, corners=rim)
