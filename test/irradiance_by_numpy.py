# SPDX-License-Identifier: Apache-2.0
"""The laws of irradiance in numpy, another text of what ``gpu/visibility/irradiance.h`` computes: (3, N) samples at a
time, and of a tube piece by piece."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import closed_forms
import numpy as np
import numpy.typing as npt
from closed_forms import dot

from shadow_tracer import DiscLight, IntensityTable, RectangleLight, SphereLight, SpotLight, Strength, TubeLight
from shadow_tracer.scene.area_lights import AreaLight
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.irradiance import _solid_angle, _watts, area_of, model_of
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.strength import LAMBERT

Bits = npt.NDArray[np.uint64]
_AT_ONCE = 4096


def unit_normals(normals: Any) -> FloatArray:
    """(N, 3) unit vectors; NaN where they are not finite, or zero."""
    flat = np.array(normals, np.float64)
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
    result, facing = np.zeros(len(points)), unit_normals(normals)
    law = _law_of(light)
    whole = bits == _all_bits(light) if law.whole is not None else np.zeros(len(bits), np.bool_)
    for asked, compute in ((whole, law.whole), ((bits != 0) & ~whole, law.some)):
        places = np.flatnonzero(asked)
        for begin in range(0, len(places), _AT_ONCE):
            part = places[begin : begin + _AT_ONCE]
            p, n = np.ascontiguousarray(points[part].T), np.ascontiguousarray(facing[part].T)
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
