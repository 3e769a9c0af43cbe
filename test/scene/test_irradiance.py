# SPDX-License-Identifier: Apache-2.0
"""Irradiance of lamps that nothing hides, against formulas from books and sums over many pieces."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import irradiance_by_numpy
import lamps
import numpy as np
import pytest

from shadow_tracer import (
    DirectionalLight,
    DiscLight,
    IntensityTable,
    PointLight,
    RectangleLight,
    SphereLight,
    SpotLight,
    Strength,
    SunDisc,
    TubeLight,
)
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.visibility.irradiance import irradiance_of
from shadow_tracer.scene.irradiance import LAWS, law_of, normals_of, power_of

WATT = Strength(power=1.0)
UNIT_RADIANCE = Strength(exitance=math.pi)
TUBE = TubeLight("tube", (-0.5, 0.0, 0.0), (0.5, 0.0, 0.0), 0.013, strength=Strength(power=15.0))
RECTANGLE = RectangleLight("panel", (0.1, 0.2, 0.0), (0.4, 0.0, 0.0), (0.0, -0.3, 0.0), strength=UNIT_RADIANCE)
DISC = DiscLight("disc", (0.1, 0.2, 0.0), (0.0, 0.0, -1.0), 0.4, strength=UNIT_RADIANCE)
SPHERE = SphereLight("bulb", (0.0, 0.0, 0.0), 0.2, samples=64, strength=WATT)


def at(light: Any, point: Any, normal: Any, bits: Any = lamps.ALL) -> float:
    """Of a light, on one sample."""
    facing = np.array([normal], float)
    return float(irradiance_of(light, np.array([point], float), facing, np.array([bits], np.uint64), "cpu")[0])


@pytest.mark.parametrize("samples", [2, 8, 64])
@pytest.mark.parametrize("distance", [0.05, 0.25, 0.5, 1.0, 2.0, 5.0])
def test_a_tube_is_as_keitz_has_it(distance: float, samples: int) -> None:
    came = at(replace(TUBE, samples=samples), (0.0, 0.0, -distance), (0.0, 0.0, 1.0))
    assert came == pytest.approx(lamps.keitz(15.0, 1.0, distance), rel=1e-12)


@pytest.mark.parametrize("distance", [0.25, 1.0])
def test_keitz_is_right_about_tubes_that_are_not_thin(distance: float) -> None:
    """Pieces of the surface of the cylinder, not of a line: the same but for their noise, 0.3 % at two sigma."""
    _, parts = lamps.contributions(TUBE, 1.0, (0.0, 0.0, -distance), np.array([0.0, 0.0, 1.0]), 200_000)
    radiance = 15.0 / math.pi  # of 1 m2 of surface
    assert radiance * parts.sum() == pytest.approx(lamps.keitz(15.0, 1.0, distance), rel=5e-3)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.3), (-0.8, 0.5, 0.1), (1.0, 0.2, -0.1)])
def test_a_tube_seen_askew(normal: Any) -> None:
    """Also where the surface's own plane cuts it."""
    point, facing = np.array([0.2, 0.1, -0.4]), np.array(normal) / np.linalg.norm(normal)
    line = np.linspace(-0.5, 0.5, 200_001)
    v = np.stack([0.5 * (line[1:] + line[:-1]) - point[0], *np.full((2, 200_000), (-point[1:])[:, None])], axis=-1)
    square = (v * v).sum(axis=1)
    sine = np.sqrt(1.0 - v[:, 0] ** 2 / square)
    cosine = np.maximum(v @ facing, 0.0) / np.sqrt(square)
    assert at(TUBE, point, normal) == pytest.approx(15.0 / math.pi**2 * (sine * cosine / square).mean(), rel=1e-6)
    glow = replace(TUBE, strength=Strength(power=15.0, model="isotropic"))
    assert at(glow, point, normal) == pytest.approx(15.0 / (4.0 * math.pi) * (cosine / square).mean(), rel=1e-6)


def test_a_tube_seen_from_its_end_and_from_inside() -> None:
    assert at(TUBE, (2.0, 0.0, 0.0), (-1.0, 0.0, 0.0)) == 0.0
    assert math.isnan(at(TUBE, (0.1, 0.005, 0.0), (0.0, 1.0, 0.0)))
    glow = replace(TUBE, strength=Strength(power=15.0, model="isotropic"))
    expected = 15.0 / (4.0 * math.pi) * (1.0 / 1.5 - 1.0 / 2.5)
    assert at(glow, (2.0, 1e-9, 0.0), (-1.0, 0.0, 0.0)) == pytest.approx(expected, rel=1e-6)
    for bits in (lamps.ALL, 2**32 - 1):
        assert math.isnan(at(glow, (0.1, 0.0, 0.0), (0.0, 1.0, 0.0), bits)), "within it"
    assert at(glow, (2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 2**64 - 1) == pytest.approx(expected, rel=1e-14)
    assert at(glow, (-2.0, 0.0, 0.0), (3.0, 4.0, 0.0)) == pytest.approx(0.6 * expected, rel=1e-14)
    assert at(glow, (2.0, 0.0, 0.0), (1.0, 0.0, 0.0)) == at(glow, (2.0, 0.0, 0.0), (0.0, 1.0, 0.0)) == 0.0


@pytest.mark.parametrize("height", [0.05, 0.2, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("aside", [0.0, 0.1, 0.39, 1.0, 5.0])
def test_a_disc_is_as_its_formula_has_it(height: float, aside: float) -> None:
    came = at(DISC, (0.1 + aside, 0.2, -height), (0.0, 0.0, 1.0))
    assert came == pytest.approx(lamps.disc_parallel(1.0, 0.4, height, aside), rel=1e-9)


@pytest.mark.parametrize("height", [0.05, 0.2, 0.5, 1.0, 3.0])
def test_a_rectangle_is_as_its_formula_has_it(height: float) -> None:
    corner, middle = (at(RECTANGLE, (x, y, -height), (0.0, 0.0, 1.0)) for x, y in ((0.5, 0.5), (0.1, 0.2)))
    assert corner == pytest.approx(lamps.rectangle_corner(1.0, 0.8, 0.6, height), rel=1e-9)
    assert middle == pytest.approx(4.0 * lamps.rectangle_corner(1.0, 0.4, 0.3, height), rel=1e-9)


@pytest.mark.parametrize("light", [RECTANGLE, DISC], ids=["rectangle", "disc"])
@pytest.mark.parametrize("point", [(0.1, 0.2, -0.5), (0.9, -0.2, -0.3), (-0.6, 0.5, -1.5)])
@pytest.mark.parametrize("normal", [(0.3, -0.2, 0.9), (-1.0, 0.1, 0.1), (0.2, 1.0, -0.2), (1.0, 0.0, -0.4)])
def test_flat_lamps_seen_askew(light: Any, point: Any, normal: Any) -> None:
    """Within 1 % of what they would give to a surface that faces them, also where the surface's own plane cuts them."""
    area = 0.48 if light is RECTANGLE else math.pi * 0.16
    facing = np.array(normal) / np.linalg.norm(normal)
    _, parts = lamps.contributions(light, area, point, facing, 100_000)
    towards = (light.position - point) / np.linalg.norm(light.position - point)
    _, most = lamps.contributions(light, area, point, towards, 100_000)
    assert at(light, point, normal) == pytest.approx(parts.sum(), abs=0.01 * most.sum())


@pytest.mark.parametrize("distance", [0.25, 0.5, 2.0])
def test_a_sphere_is_as_a_point_to_what_faces_it(distance: float) -> None:
    random = np.random.default_rng(2)
    for way in random.normal(size=(5, 3)):
        way /= np.linalg.norm(way)
        came = at(SPHERE, distance * way, -way)
        assert came == pytest.approx(1.0 / (4.0 * math.pi * distance**2), rel=1e-12)
    _, parts = lamps.contributions(SPHERE, 1.0, (0.0, 0.0, distance), np.array([0.0, 0.0, -1.0]), 100_000)
    assert parts.sum() / math.pi == pytest.approx(1.0 / (4.0 * math.pi * distance**2), rel=0.02)


def test_inside_a_sphere_and_upon_a_point_there_is_no_answer() -> None:
    assert math.isnan(at(SPHERE, (0.1, 0.0, 0.0), (1.0, 0.0, 0.0)))
    assert math.isnan(at(PointLight("p", (1, 2, 3), strength=WATT), (1, 2, 3), (0, 0, 1), 1))


def test_a_point_is_i_cos_cubed_over_h_squared() -> None:
    light = PointLight("p", (0.0, 0.0, 2.0), strength=Strength(intensity=3.0, output=0.5))
    for aside in (0.0, 0.5, 4.0):
        cosine = 2.0 / math.hypot(2.0, aside)
        assert at(light, (aside, 0, 0), (0, 0, 1), 1) == pytest.approx(1.5 * cosine**3 / 4.0, rel=1e-14)
    assert at(light, (1, 0, 0), (0, 0, -1), 1) == 0.0
    assert at(light, (1, 0, 0), (0, 0, -1), 0) == 0.0


def test_spots_keep_their_power_in_the_cone() -> None:
    down = SpotLight("s", (0.0, 0.0, 2.0), (0.0, 0.0, -1.0), math.pi / 3.0, strength=Strength(power=math.pi))
    assert at(down, (0, 0, 0), (0, 0, 1), 1) == pytest.approx(1.0 / 4.0, rel=1e-12)
    lambert = replace(down, strength=Strength(power=math.pi, model="lambert"))
    assert at(lambert, (0, 0, 0), (0, 0, 1), 1) == pytest.approx(1.0 / math.sin(math.pi / 3.0) ** 2 / 4.0, rel=1e-12)
    aside = at(lambert, (1.0, 0, 0), (0, 0, 1), 1) / at(lambert, (0, 0, 0), (0, 0, 1), 1)
    assert aside == pytest.approx((4.0 / 5.0) ** 2, rel=1e-12)


def test_lights_at_infinity() -> None:
    sun = DirectionalLight("sun", (0.0, 3.0, -4.0), strength=Strength(irradiance=1000.0))
    assert at(sun, (5, 5, 5), (0, 0, 1), 1) == pytest.approx(800.0, rel=1e-14)
    assert at(sun, (5, 5, 5), (0, 0, -1), 1) == 0.0
    disc = SunDisc("sun", (0.0, 3.0, -4.0), math.radians(30.0), strength=Strength(irradiance=1000.0))
    assert at(disc, (5, 5, 5), (0, -3, 4)) == pytest.approx(1000.0, rel=1e-14)
    assert at(disc, (5, 5, 5), (0, 0, 1)) == pytest.approx(800.0, rel=1e-2)
    assert at(disc, (5, 5, 5), (0, -3, 4), 2**32 - 1) == pytest.approx(500.0, rel=0.05)


@pytest.mark.parametrize("light", [TUBE, RECTANGLE, DISC, SPHERE], ids=["tube", "rectangle", "disc", "sphere"])
def test_which_points_reach_matters_not_only_how_many(light: Any) -> None:
    """Points near to the sample give more than the others, and all of them the whole."""
    point, normal = (0.4, -0.1, -0.3), (0.1, 0.1, 1.0)
    places = np.argsort(np.linalg.norm(light.points - point, axis=1))
    near, far = (sum(1 << int(k) for k in half) for half in (places[:32], places[32:]))
    some = [at(light, point, normal, bits) for bits in (near, far, lamps.ALL)]
    assert some[0] > some[1] and some[0] + some[1] == pytest.approx(some[2], rel=1e-12)


SPOT = SpotLight("s", (0.0, 0.0, 0.0), (0.0, 0.3, -1.0), 1.2, strength=WATT)
EVERY = [
    TUBE,
    replace(TUBE, strength=Strength(power=15.0, model="isotropic")),
    RECTANGLE,
    replace(RECTANGLE, two_sided=True),
    replace(RECTANGLE, strength=Strength(power=1.0, model="isotropic")),
    DISC,
    replace(DISC, two_sided=True, strength=Strength(intensity=2.0)),
    SPHERE,
    replace(SPHERE, strength=Strength(power=1.0, model="isotropic")),
    PointLight("p", (0.0, 0.0, 0.0), strength=WATT),
    SPOT,
    replace(SPOT, strength=Strength(power=1.0, model="lambert")),
    PointLight(
        "t",
        (0.0, 0.0, 0.0),
        strength=Strength(
            power=2.0,
            model=IntensityTable((0.0, 1.0, 2.0), (0.0, 2.0, 2.0 * math.pi), [[3, 2, 1], [1, 1, 0], [3, 2, 1]]),
        ),
    ),
]


@pytest.mark.parametrize("light", EVERY, ids=lambda light: f"{light.name}-{light.strength.model}")
def test_what_leaves_a_lamp_arrives_on_a_sphere_around_it(light: Any) -> None:
    """The sum of irradiance times area is the power, within 1 %."""
    k = np.arange(4000)
    z = 1.0 - (2.0 * k + 1.0) / len(k)
    turn = k * math.pi * (3.0 - math.sqrt(5.0))
    ring = np.sqrt(1.0 - z * z)
    out = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=-1)
    points = 1.5 * out
    bits = np.full(len(k), lamps.ALL)
    if isinstance(light, SpotLight):
        axis, cosine = light.cone
        bits[points @ axis < 1.5 * cosine] = 0
    normal = getattr(light, "normal", None)
    if normal is not None and not light.two_sided:
        bits[(points - light.position) @ normal <= 0.0] = 0
    found = irradiance_of(light, points, -out, bits)
    assert found.mean() * 4.0 * math.pi * 1.5**2 == pytest.approx(power_of(light), rel=0.01)


def test_a_table_is_taken_as_it_is_or_scaled() -> None:
    table = IntensityTable((0.0, 1.0, 2.0), (0.0,), [[6.0, 3.0, 0.0]])
    for strength, ahead in (
        (Strength(model=table), 6.0),
        (Strength(model=table, output=0.5), 3.0),
        (Strength(intensity=2.0, model=table), 2.0),
        (Strength(power=2.0 * table.power, model=table), 12.0),
    ):
        light = PointLight("t", (0.0, 0.0, 2.0), strength=strength)
        assert at(light, (0, 0, 0), (0, 0, 1), 1) == pytest.approx(ahead / 4.0, rel=1e-12)
        assert power_of(light) == pytest.approx(table.power * ahead / 6.0, rel=1e-12)
    with pytest.raises(ValueError, match="light: expected one with a strength that is not infinitely far away"):
        power_of(PointLight("dark", (0, 0, 0)))


def test_quantities_of_one_lamp_agree() -> None:
    for light in (TUBE, RECTANGLE, DISC, SPHERE, replace(DISC, two_sided=True)):
        power = power_of(light)
        far = np.array([0.0, 0.0, -1e6])
        intensity = 1e12 * at(light, far, (0.0, 0.0, 1.0))
        assert power_of(replace(light, strength=Strength(intensity=intensity))) == pytest.approx(power, rel=1e-5)
    assert power_of(replace(DISC, two_sided=True)) == pytest.approx(2.0 * power_of(DISC))
    assert power_of(replace(TUBE, strength=Strength(exitance=1.0))) == pytest.approx(2.0 * math.pi * 0.013)


def test_no_sample_changes_another_ones_bits() -> None:
    random = np.random.default_rng(3)
    points, normals = random.normal(size=(2, 5000, 3))
    points[:, 2] = -np.abs(points[:, 2]) - 0.3
    bits = random.integers(0, 2**63, 5000, dtype=np.uint64)
    order = random.permutation(5000)
    for light in EVERY:
        together = irradiance_of(light, points, normals, bits)
        assert np.array_equal(irradiance_of(light, points[order], normals[order], bits[order]), together[order])
        assert np.array_equal(irradiance_of(light, points[7:8], normals[7:8], bits[7:8]), together[7:8])


def test_unknown_normals() -> None:
    light = replace(RECTANGLE, strength=WATT)
    points = np.tile([0.1, 0.2, -1.0], (3, 1))
    facing = normals_of([[np.nan, 0, 1], [0, 0, 0], [0, 0, 5]], (3,))
    found = irradiance_of(light, points, facing, np.array([1, 0, 1], np.uint64))
    assert math.isnan(found[0]) and found[1] == 0.0 and found[2] > 0.0
    with pytest.raises(ValueError, match=r"normals: expected real numbers of shape \(3, 3\)"):
        normals_of(np.zeros((2, 3)), (3,))


@pytest.mark.parametrize("light", EVERY, ids=lambda light: f"{light.name}-{light.strength.model}")
def test_no_law_takes_an_unknown_normal_for_a_dark_surface(light: Any) -> None:
    """Whether some of its points reach, or all."""
    points = np.tile([0.1, 0.2, -1.0], (3, 1))
    facing = np.full((3, 3), np.nan)
    bits = np.array([1, lamps.ALL, 2 ** getattr(light, "samples", 1) - 1], np.uint64)
    assert np.isnan(irradiance_of(light, points, facing, bits)).all()


def test_pieces_that_a_gpu_takes_are_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """In buffers, some samples at a time, as where the CPU has them."""
    random = np.random.default_rng(12)
    points, normals = random.normal(size=(2, 700, 3))
    bits = random.integers(0, 2**63, 700, dtype=np.uint64)
    for light in (TUBE, DISC, EVERY[-1]):
        expected = irradiance_of(light, points, normals, bits, "cpu")
        monkeypatch.setattr("shadow_tracer.gpu.visibility.irradiance._meters", {})  # buffers are kept from call to call
        monkeypatch.setattr("shadow_tracer.gpu.visibility.irradiance._PIECE", 256)
        with forms.cuda_form():
            np.testing.assert_array_equal(irradiance_of(light, points, normals, bits, "cpu"), expected)
    assert irradiance_of(TUBE, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.uint64), "cpu").shape == (0,)


def test_a_disc_behind_the_surface_gives_nothing() -> None:
    for normal in ((0.0, 0.0, -1.0), (0.6, 0.0, -0.8), (0.999, 0.0, -0.04)):
        assert at(DISC, (0.8, 0.2, -1.0), normal) == 0.0


def test_points_of_a_wide_sun_span_what_they_are_seen_to() -> None:
    """Of a disc of even radiance the share within a smaller angle goes with the square of its sine."""
    wide = SunDisc("sun", (0.0, 0.0, -1.0), math.radians(80.0), strength=Strength(irradiance=1.0))
    inner = math.atan(math.tan(math.radians(40.0)) * math.sqrt(0.5))  # the first half of the points, by area
    share = at(wide, (0, 0, 0), (0, 0, 1), 2**32 - 1)
    assert share == pytest.approx((math.sin(inner) / math.sin(math.radians(40.0))) ** 2, rel=0.02)


def test_polygons_seen_edge_on_and_from_below_give_nothing() -> None:
    both = RectangleLight("panel", (0, 0, 0), (1, 0, 0), (0, 1, 0), two_sided=True, strength=UNIT_RADIANCE)
    assert at(both, (3.0, 0.0, 0.0), (-1.0, 0.0, 0.0)) == pytest.approx(0.0, abs=1e-12)
    assert at(both, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)) == 0.0
    for z in (-1.0, 1.0):
        assert at(both, (0.0, 0.0, z), (0.0, 0.0, -z)) == pytest.approx(
            4.0 * lamps.rectangle_corner(1.0, 1.0, 1.0, 1.0)
        )


def bound(light: Any, points: Any, bits: Any) -> Any:
    """(N,) by how much two ways to compute it may differ: twice what ``gpu/visibility/irradiance.py`` derives of one,
    with two roundings for each of a function of the C library."""
    law, u = law_of(light), 2.0**-53
    # A surface that faces the light gets no more than the six that face along the axes together.
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    facing = sum(irradiance_by_numpy.irradiance_of(light, points, np.tile(n, (len(points), 1)), bits) for n in axes)
    steps = 24.0 + 2.0 * law.count
    if law.kind == LAWS.index("line"):
        steps += 16.0 * law.count * (np.linalg.norm(points - law.centre, axis=1) + law.length) / law.length
    # Edges of a polygon cancel: each has the angle that it spans.
    edges = np.linalg.norm(law.corners - np.roll(law.corners, 1, axis=0), axis=1).sum()
    near = min((np.linalg.norm(points - corner, axis=1) for corner in law.corners), key=np.min, default=1.0)
    return u * (steps * facing + 16.0 * max(1, len(law.corners)) * law.scale * edges / near)


@pytest.mark.parametrize("light", EVERY, ids=lambda light: f"{light.name}-{light.strength.model}")
def test_the_kernel_is_as_exact_as_it_says(any_device: str, light: Any) -> None:
    """Against another text of the same laws, in numpy, point by point and piece by piece: all reach, some, one."""
    random = np.random.default_rng(11)
    points = random.normal(size=(900, 3)) * random.choice([0.5, 1.0, 10.0], (900, 1))
    normals = random.normal(size=(900, 3)) * random.choice([1e-200, 1.0, 1e200], (900, 1))
    bits = random.integers(0, 2**63, 900, dtype=np.uint64) * np.uint64(2)
    bits[::3] = 2**64 - 1
    bits[1::9] = np.uint64(1) << random.integers(0, 64, 100, dtype=np.uint64)
    count = getattr(light, "samples", 1)
    bits &= np.uint64(2**count - 1)
    found = irradiance_of(light, points, normals, bits, any_device)
    expected = irradiance_by_numpy.irradiance_of(light, points, normals, bits)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    known = ~np.isnan(found)
    assert (np.abs(found - expected) <= bound(light, points, bits))[known].all()
    assert (found[known] > 0.0).sum() > 50


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ({}, "exactly one of power"),
        ({"power": 1.0, "exitance": 1.0}, "got power and exitance"),
        ({"power": -1.0}, "strength.power: expected a number from 0"),
        ({"power": math.nan}, "strength.power"),
        ({"intensity": "3"}, "strength.intensity"),
        ({"power": 1.0, "output": 1.5}, "strength.output: expected a factor from 0 to 1"),
        ({"power": 1.0, "model": "phong"}, "strength.model: expected 'isotropic', 'lambert'"),
    ],
)
def test_strengths_that_are_none(what: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Strength(**what)


@pytest.mark.parametrize(
    ("light", "strength", "says"),
    [
        (PointLight("p", (0, 0, 0)), Strength(exitance=1.0), "strength.exitance: a PointLight has none"),
        (PointLight("p", (0, 0, 0)), Strength(power=1.0, model="lambert"), "strength.model: expected 'isotropic'"),
        (DirectionalLight("d", (0, 0, 1)), WATT, "strength.power: a DirectionalLight has none; expected irradiance"),
        (DISC, Strength(irradiance=1.0), "strength.irradiance: a DiscLight has none; expected power or intensity"),
        (replace(TUBE, radius=0.0), Strength(exitance=1.0), "strength.exitance: a tube of radius 0"),
        (DISC, 5.0, "strength: expected a Strength or None"),
    ],
)
def test_lights_refuse_strengths_that_they_cannot_have(light: Any, strength: Any, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        replace(light, strength=strength)
