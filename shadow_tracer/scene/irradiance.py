# SPDX-License-Identifier: Apache-2.0
"""Irradiance [W/m2] of samples, from which points of a light reach them.

Each point of a light bears its part of the light's power, with the cosines and the distance that it has from the sample
in question: which points reach matters, not only how many. Where the irradiance of the whole light has a closed form
(Lambertian discs, rectangles and spheres), the points say which part of that arrives, so the sum over all of them is as
exact as the formula, near to the lamp as well (ratio estimator: Heitz, Hill and McGuire 2018). A tube is cut into as
many pieces as it has points; each has a closed form. All else is the sum over the points.

Everything is float64, and sums go over the points in their order, one sample at a time: neither the order of samples
nor who else asks changes a bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene import closed_forms
from shadow_tracer.scene.area_lights import MOST_BITS, AreaLight, DiscLight, RectangleLight, SphereLight, TubeLight
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.closed_forms import dot
from shadow_tracer.scene.hard_lights import SpotLight
from shadow_tracer.scene.intensity_table import IntensityTable
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.strength import ISOTROPIC, LAMBERT, Strength

Bits = npt.NDArray[np.uint64]
_AT_ONCE = 4096  # samples: what is computed of them stays in a core's cache


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


def unit_normals(value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Normals of a leading ``shape`` as (N, 3) unit vectors; NaN where they are not finite, or zero.

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
    flat = normals.reshape(-1, 3).astype(np.float64)
    with np.errstate(all="ignore"):
        flat /= np.abs(flat).max(axis=1, keepdims=True)
        flat /= np.sqrt((flat * flat).sum(axis=1, keepdims=True))
    flat[~np.isfinite(flat).all(axis=1)] = np.nan
    return flat


def irradiance_of(light: Light, points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
    """Irradiance of one light, which has a strength.

    Args:
        light: the light.
        points: (N, 3) positions in the world [m].
        normals: (N, 3) unit normals on the side that is asked about, NaN where unknown.
        bits: (N,) which of its points reach, as :meth:`ShadowTracer.light_bits` has them.

    Returns:
        (N,) float64 [W/m2]: 0 where no point reaches, whatever the normal, and where all that reach are behind the
        surface; NaN where points reach and the normal is unknown, and inside a sphere or tube and upon a point.
    """
    result = np.zeros(len(points))
    law = _law_of(light)
    whole = bits == _all_bits(light) if law.whole is not None else np.zeros(len(bits), np.bool_)
    for asked, compute in ((whole, law.whole), ((bits != 0) & ~whole, law.some)):
        places = np.flatnonzero(asked)
        for begin in range(0, len(places), _AT_ONCE):
            part = places[begin : begin + _AT_ONCE]
            p, n = np.ascontiguousarray(points[part].T), np.ascontiguousarray(normals[part].T)
            assert compute is not None
            with np.errstate(all="ignore"):
                found = compute(p, n, bits[part])
            result[part] = np.where(np.isfinite(n).all(axis=0) & np.isfinite(found), found, np.nan)
    return result


Sum = Callable[[FloatArray, FloatArray, Bits], FloatArray]


@dataclass(frozen=True)
class Law:
    """How a light's irradiance is computed, of (3, N) samples.

    Attributes:
        some: from the points that reach.
        whole: the same up to roundings where all of them do, in a fraction of the time; None if there is no such way.
    """

    some: Sum
    whole: Sum | None = None


def _all_bits(light: Light) -> np.uint64:
    return np.uint64((1 << light.samples) - 1 if isinstance(light, AreaLight) else 1)


def _law_of(light: Light) -> Law:
    strength = light.strength
    assert strength is not None
    if strength.quantity == "irradiance":
        return _endless(light, strength)
    watts = _watts(light, strength) * strength.output
    model = model_of(light)
    if isinstance(model, IntensityTable):
        return _table(light, model, watts / model.power)
    if isinstance(light, TubeLight):
        return _tube(light, model, watts)
    if model == LAMBERT and isinstance(light, (DiscLight, RectangleLight)):
        return _flat(light, watts / (math.pi * area_of(light)))
    if model == LAMBERT and isinstance(light, SphereLight):
        return _sphere(light, watts / (math.pi * area_of(light)))
    if model == LAMBERT and isinstance(light, SpotLight):
        return _spot(light, watts / _solid_angle(light, model))
    return _alike(light, watts / _solid_angle(light, model))


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


def _reaching(bits: Bits, count: int) -> Iterator[npt.NDArray[np.bool_]]:
    """Of one point after the other, which samples it reaches."""
    octets = np.ascontiguousarray(bits, "<u8").view(np.uint8).reshape(-1, 8)
    single = np.unpackbits(octets, axis=1, bitorder="little").T.astype(np.bool_)
    return iter(single[:count])


def _points(light: Light) -> FloatArray:
    """(K, 3) of a light that is not at infinity."""
    at = light.homogeneous_points if isinstance(light, AreaLight) else light.homogeneous[None]
    return at[:, :3]


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

    def law(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        total = np.zeros(points.shape[1])
        for way, weight, reaches in zip(ways, weights, _reaching(bits, len(ways)), strict=True):
            total += np.where(reaches, weight * np.maximum(-dot(normals, way), 0.0), 0.0)
        return total

    return Law(law)


def _alike(light: Light, intensity: float) -> Law:
    """Every point shines alike in all directions, together with ``intensity`` [W/sr]."""
    places = _points(light)

    def law(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        total = np.zeros(points.shape[1])
        for place, reaches in zip(places, _reaching(bits, len(places)), strict=True):
            v = place[:, None] - points
            square = dot(v, v)
            total += np.where(reaches, np.maximum(dot(v, normals), 0.0) / (square * np.sqrt(square)), 0.0)
        return total * (intensity / len(places))

    return Law(law)


def _spot(light: SpotLight, intensity: float) -> Law:
    """The cosine to its direction."""
    axis = light.cone[0]

    def law(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        v = light.position[:, None] - points
        square = dot(v, v)
        return intensity * np.maximum(-dot(v, axis), 0.0) * np.maximum(dot(v, normals), 0.0) / (square * square)

    return Law(law)


def _table(light: Light, table: IntensityTable, factor: float) -> Law:
    places = _points(light)

    def law(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        total = np.zeros(points.shape[1])
        for place, reaches in zip(places, _reaching(bits, len(places)), strict=True):
            v = place[:, None] - points
            square = dot(v, v)
            part = table.towards(-v.T) * np.maximum(dot(v, normals), 0.0) / (square * np.sqrt(square))
            total += np.where(reaches, part, 0.0)
        return total * (factor / len(places))

    return Law(law)


def _tube(light: TubeLight, model: str, watts: float) -> Law:
    """Each point stands for a piece of the axis; pieces have closed forms."""
    length = float(np.linalg.norm(light.end - light.start))
    axis = (light.end - light.start) / length
    per_metre = watts / length / (math.pi**2 if model == LAMBERT else 4.0 * math.pi)

    def total(points: FloatArray, normals: FloatArray, pieces: list[tuple[float, float, Any]]) -> FloatArray:
        line = closed_forms.Line(light.start, axis, points, normals)
        piece = line.lambert if model == LAMBERT else line.isotropic
        total = np.zeros(points.shape[1])
        for begin, end, reaches in pieces:
            total += np.where(reaches, piece(begin, end), 0.0)
        beside = (line.begin > 0.0) | (line.begin + length < 0.0)
        if model == LAMBERT:  # of which nothing is seen on the axis beyond the ends
            total[beside & (line.distance == 0.0)] = 0.0
        # Inside there is no answer.
        total[~beside & ((line.distance < light.radius) | (line.distance == 0.0))] = np.nan
        return total * per_metre

    def some(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        ends = [length * k / light.samples for k in range(light.samples + 1)]
        return total(points, normals, list(zip(ends[:-1], ends[1:], _reaching(bits, light.samples), strict=True)))

    return Law(some, lambda points, normals, bits: total(points, normals, [(0.0, length, True)]))


def _flat(light: DiscLight | RectangleLight, radiance: float) -> Law:
    """Of even radiance [W/m2/sr]: the whole in closed form, times the part that the points say."""
    places, normal, two_sided = light.points, light.normal, light.two_sided
    normal = normal / math.sqrt(float(normal @ normal))
    if isinstance(light, RectangleLight):
        corners = light.position + np.array([[1, 1], [-1, 1], [-1, -1], [1, -1.0]]) @ np.stack([light.u, light.v])

    def whole(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        if isinstance(light, RectangleLight):
            return radiance * closed_forms.polygon(corners, points, normals)
        return radiance * closed_forms.disc(light.position, normal, light.radius, points, normals)

    def law(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        some, all_of_it = np.zeros((2, points.shape[1]))
        for place, reaches in zip(places, _reaching(bits, len(places)), strict=True):
            v = place[:, None] - points
            square, turned = dot(v, v), -dot(v, normal)
            turned = np.abs(turned) if two_sided else np.maximum(turned, 0.0)
            part = turned * np.maximum(dot(v, normals), 0.0) / (square * square)
            all_of_it += part
            some += np.where(reaches, part, 0.0)
        return whole(points, normals, bits) * np.where(all_of_it == 0.0, 0.0, some / all_of_it)

    return Law(law, whole)


def _sphere(light: SphereLight, radiance: float) -> Law:
    """The same of a sphere: each point shines from its side of it. Where the sample's plane cuts it, the whole is what
    reaches a plane that faces it, and the points say what of that is above."""
    places = light.points
    outward = (places - light.position) / light.radius

    def law(points: FloatArray, normals: FloatArray, bits: Bits) -> FloatArray:
        some, all_of_it = np.zeros((2, points.shape[1]))
        facing = np.zeros_like(points)
        for place, out, reaches in zip(places, outward, _reaching(bits, len(places)), strict=True):
            v = place[:, None] - points
            square = dot(v, v)
            turned = np.maximum(-dot(v, out), 0.0) / (square * square)
            facing += turned * v
            part = turned * np.maximum(dot(v, normals), 0.0)
            all_of_it += part
            some += np.where(reaches, part, 0.0)
        v = light.position[:, None] - points
        square, up = dot(v, v), dot(v, normals)
        whole = math.pi * light.radius**2 / square
        seen = np.sqrt(dot(facing, facing))
        cosine = up / np.sqrt(square)
        share = np.where(up >= light.radius, cosine * some / all_of_it, some / seen)
        share = np.where(up <= -light.radius, 0.0, share)
        return np.where((square > light.radius**2) & (seen > 0.0), radiance * whole * share, np.nan)

    return Law(law)
