# SPDX-License-Identifier: Apache-2.0
"""Lights with size: every bit is the exact answer of one point, in every pipeline; where they shine; what they ignore
is in ``test_ignored_meshes.py``."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import probe
import pytest

from shadow_tracer import (
    Bounds,
    Camera,
    DirectionalLight,
    DiscLight,
    PointLight,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    State,
    SunDisc,
    TubeLight,
)
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_LAMPS: list[Any] = [
    RectangleLight("panel", (0.5, 0.25, 3.0), (0.0, 0.75, 0.0), (0.5, 0.0, 0.0), samples=16),
    RectangleLight("both", (-2.5, 0.25, 1.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.25), True, samples=9),
    DiscLight("disc", (-0.5, 0.25, 2.5), (0.25, 0.125, -1.0), 0.5, range=4.5, samples=13),
    TubeLight("tube", (-1.0, 0.0, 2.5), (1.0, 0.5, 2.25), 0.125, samples=16),
    TubeLight("line", (-1.0, 0.0, 2.5), (1.0, 0.5, 2.25), range=3.0, samples=7),
    SunDisc("sun", (0.25, 0.375, -1.0), 0.25, samples=11),
    SphereLight("ball", (0.5, 0.25, 3.0), 0.5, samples=8),
    PointLight("hard", (0.5, 0.25, 3.0)),
]
_BIAS = 0.01
_SMALL = {"max_triangles": 700, "max_rays": 700, "max_lights": 8, "queue_capacity": 2000, "grid_entries": 20_000}


@pytest.fixture
def small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several threads have work in a hundred samples."""
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 32)


@cache
def _scene() -> geometry.Geometry:
    ball, rubble = geometry.icosphere(1, 0.6, (0.3, 0.2, 1.4)), geometry.soup(np.random.default_rng(170), 120, 0.4, 1.5)
    return geometry.join([geometry.square(2, -1.5, 8.0), ball, rubble])


@cache
def _points() -> np.ndarray:
    points = np.random.default_rng(171).uniform((-3, -3, -1.5), (3, 3, 3.5), (300, 3))
    points[::25] = np.nan
    return points


def _expected(light: Any, points: np.ndarray, scene: geometry.Geometry, bias: float) -> np.ndarray:
    """(N,) bits of a light's points that reach, by the oracle."""
    bits = np.zeros(len(points), np.uint64)
    for number, point in enumerate(light.hard_lights()):
        answer = oracle.occluded(points, point, *scene, bias)
        assert not answer.tie.any()
        bits |= (~answer.hidden).astype(np.uint64) << np.uint64(number)
    return bits


def _shines(light: Any, points: np.ndarray) -> np.ndarray:
    """Where a light shines, told in another way."""
    shines = np.ones(len(points), bool)
    if not isinstance(light, SunDisc):
        shines &= np.linalg.norm(points - light.position, axis=1) <= light.range
    if isinstance(light, (DiscLight, RectangleLight)) and not light.two_sided:
        shines &= (points - light.position) @ light.normal > 0.0
    return shines


@cache
def _truth() -> list[np.ndarray]:
    """Of each lamp with size, (N,) bits."""
    finite = np.where(np.isfinite(_points()), _points(), 0.0)
    found = []
    for light in _LAMPS[:-1]:
        bits = _expected(light, finite, _scene(), _BIAS)
        bits[~_shines(light, finite) | np.isnan(_points()[:, 0])] = 0
        found.append(bits)
    return found


def test_every_bit_is_an_exact_shadow(tracer: Any) -> None:
    tracer.scene.put("scene", *_scene())
    bits = tracer.light_bits(_points(), _LAMPS, _BIAS)
    share = tracer.visibility(_points(), _LAMPS, _BIAS)
    states = tracer.states_at(_points(), _LAMPS, _BIAS)
    unknown = np.isnan(_points()[:, 0])
    for number, (light, true) in enumerate(zip(_LAMPS, _truth(), strict=False)):
        np.testing.assert_array_equal(bits[number], true, err_msg=light.name)
        counts = np.array([int(value).bit_count() for value in true])
        expected = (counts / light.samples).astype(np.float32)
        expected[unknown] = np.nan
        np.testing.assert_array_equal(share[number], expected, err_msg=light.name)
        state = np.where(counts == 0, State.SHADOWED, np.where(counts == light.samples, State.LIT, State.PENUMBRA))
        state[~_shines(light, _points())] = State.OUTSIDE
        state[unknown] = State.INVALID
        np.testing.assert_array_equal(states[number], state, err_msg=light.name)
    np.testing.assert_array_equal(bits[-1], states[-1] == State.LIT)
    np.testing.assert_array_equal(share[-1], np.where(unknown, np.nan, bits[-1].astype(np.float32)))
    assert bits.dtype == np.uint64 and share.dtype == np.float32


def test_the_scene_tells_the_answers_apart() -> None:
    for light, true in zip(_LAMPS, _truth(), strict=False):
        counts = np.array([int(value).bit_count() for value in true])
        assert ((counts > 0) & (counts < light.samples)).sum() >= 15, light.name
        assert (counts == light.samples).sum() >= 15, light.name
    assert sum(bool((~_shines(light, _points())).sum() > 20) for light in _LAMPS[:-1]) == 3


@pytest.mark.parametrize("graphs", [False, True])
@pytest.mark.usefixtures("small_bands")
@probe.in_forms("names", ["light_grid", "cone_hierarchy", "mesh_bvh"], ["light_grid", "mesh_bvh"])
@pytest.mark.slow
def test_frames_recorded_or_not_by_any_number_of_threads(any_device: str, names: str, graphs: bool) -> None:
    """The same bits as of points: in images, again and again, in another order of samples."""
    camera = Camera(12, 9, 11.0, 11.0, 5.5, 4.0, geometry.look_at((-4.0, 0.5, 2.0), (0, 0, 0.5), (0, 0, 1)))
    depth = np.random.default_rng(172).uniform(1.0, 7.0, (9, 12)).astype(np.float32)
    depth[3, 4] = np.nan
    points = camera.unproject(np.where(np.isnan(depth), 1.0, depth)).reshape(-1, 3)
    shuffle = np.random.default_rng(173).permutation(len(points))
    oracle_tracer = ShadowTracer("brute_force", device=any_device, bounds=Bounds(**_SMALL), threads=1)
    oracle_tracer.scene.put("scene", *_scene())
    true = oracle_tracer.light_bits(points, _LAMPS, _BIAS)
    for threads in (1, 3):
        tracer = ShadowTracer(names, device=any_device, bounds=Bounds(**_SMALL), graphs=graphs, threads=threads)
        tracer.scene.put("scene", *_scene())
        assert len(probe.bands(tracer)) == (threads if probe.wide(any_device) and not graphs else 1)
        for _ in range(3):
            frame = tracer.trace(depth, camera, _LAMPS, _BIAS)
            for number, light in enumerate(_LAMPS):
                expected = np.where(np.isnan(depth), np.uint64(0), true[number].reshape(depth.shape))
                np.testing.assert_array_equal(frame.light_bits(light.name), expected)
        np.testing.assert_array_equal(tracer.light_bits(points[shuffle], _LAMPS, _BIAS), true[:, shuffle])
        assert tracer.verify(depth, camera, _LAMPS, _BIAS) == 0


@probe.in_forms("names", ["light_grid", "mesh_bvh", "bvh"], ["light_grid", "mesh_bvh", "bvh"])
@pytest.mark.slow
def test_capacities_of_one(any_device: str, names: str) -> None:
    bounds = Bounds(**{**_SMALL, "queue_capacity": 1, "grid_entries": 1, "max_lights": 1})
    tracer = ShadowTracer(names, device=any_device, bounds=bounds)
    tracer.scene.put("scene", *_scene())
    for number in (0, 5):
        bits = tracer.light_bits(_points()[:60], [_LAMPS[number]], _BIAS)[0]
        np.testing.assert_array_equal(bits, _truth()[number][:60])


@pytest.mark.parametrize("names", ["brute_force", "mesh_bvh", "light_grid", "cone_hierarchy"])
def test_ties_against_fractions(any_device: str, names: str) -> None:
    """Small integers: rays through corners and edges, light points in planes of triangles, samples on them."""
    rng = np.random.default_rng(174)
    mesh = geometry.integer_soup(rng, 60)
    tracer = ShadowTracer(names, device=any_device, bounds=Bounds(**_SMALL))
    tracer.scene.put("mesh", *mesh)
    points = rng.integers(-4, 5, (12, 3)).astype(float)
    lights = [
        RectangleLight("a", (0.0, 0.0, 4.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0), True, samples=4),
        TubeLight("b", (-4.0, 2.0, 3.0), (4.0, 2.0, 3.0), samples=4),
        RectangleLight("c", (0.0, 0.0, 0.0), (2.0, 2.0, 0.0), (0.0, 0.0, 4.0), True, samples=2),
    ]
    for light, bits in zip(lights, tracer.light_bits(points, lights), strict=True):
        for number, point in enumerate(light.hard_lights()):
            hidden = oracle.occluded_exact(points, point, *mesh)
            np.testing.assert_array_equal(bits >> np.uint64(number) & np.uint64(1), ~hidden, err_msg=light.name)


@pytest.mark.parametrize("names", ["brute_force", "mesh_bvh", "light_grid"])
def test_sheets_with_corners_on_the_rays(any_device: str, names: str) -> None:
    """Sheets of triangles that share a corner, which lies exactly on the ray to one of 64 points: nothing gets through
    where they meet, and nothing is hidden beside."""
    tracer = ShadowTracer(names, device=any_device, bounds=Bounds(**_SMALL))
    light = RectangleLight("panel", (0.0, 0.0, 8.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), True)
    sample = np.array([0.5, -0.25, 0.0])
    middles = 0.5 * (sample + light.points)  # dyadic, and exact
    angle = 2.0 * np.pi / 6 * np.arange(6)
    ring = np.round(0.0625 * np.column_stack([np.cos(angle), np.sin(angle), 0.2 * np.sin(3 * angle)]) * 2**20) / 2**20
    for number in (0, 21, 42, 63):
        corners = np.concatenate([[middles[number]], middles[number] + ring])
        fan = np.array([(0, 1 + k, 1 + (k + 1) % 6) for k in range(6)])
        tracer.scene.put("fan", corners, fan)
        bits = tracer.light_bits(sample, [light])[0]
        assert not int(bits) >> number & 1
        assert int(bits) == int(_expected(light, sample[None], (corners, fan), 0.0)[0])
        tracer.scene.put("fan", corners, fan[:3])  # half of it: the corner alone hides the point
        assert not int(tracer.light_bits(sample, [light])[0]) >> number & 1


def test_a_tiny_light_is_a_hard_one_and_a_far_one_too(any_device: str) -> None:
    tracer = ShadowTracer("mesh_bvh", device=any_device, bounds=Bounds(**_SMALL))
    tracer.scene.put("scene", *_scene())
    points = _points()[np.isfinite(_points()[:, 0])]
    for place, size in (((0.5, 0.25, 3.0), 1e-9), ((0.3e6, 0.2e6, 0.9e6), 1.0)):
        hard = tracer.light_bits(points, [PointLight("p", place)], _BIAS)[0].astype(bool)
        lights = [
            DiscLight("disc", place, (0, 0, 1), size, True),
            TubeLight("tube", place, np.add(place, (0, 0, size)), size),
        ]
        for bits in tracer.light_bits(points, lights, _BIAS):
            assert set(bits.tolist()) <= {0, 2**64 - 1} and np.array_equal(bits > 0, hard)
    sun = SunDisc("sun", (0.25, 0.375, -1.0), 1e-9)
    bits = tracer.light_bits(points, [DirectionalLight("d", (0.25, 0.375, -1.0)), sun], _BIAS)
    assert set(bits[1].tolist()) == {0, 2**64 - 1} and np.array_equal(bits[0] > 0, bits[1] > 0)


@pytest.mark.parametrize("names", ["mesh_bvh/refit", "mesh_bvh/binary"])
def test_the_bundle_to_the_sun_is_as_wide_as_the_disc(any_device: str, names: str) -> None:
    """A speck far away is met by the outermost directions alone; from a sample far from the scene, too."""
    tracer = ShadowTracer(*names.split("/"), device=any_device, bounds=Bounds(**_SMALL))
    hard = ShadowTracer("light_grid", device=any_device, bounds=Bounds(**_SMALL))
    sun = SunDisc("sun", (0.0, 0.0, -1.0), 0.2)
    outermost = -sun.directions[int(np.argmax(np.linalg.norm(sun.directions[:, :2], axis=1)))]
    for start in ((0.0, 0.0, 0.0), (500.0, -300.0, -4000.0)):
        speck = np.array(start) + 100.0 * outermost
        corners = speck + 0.01 * np.array([(1, 0, 0), (-1, 1, 0), (-1, -1, 0)])
        for each in (tracer, hard):
            each.scene.put("speck", corners, [(0, 1, 2)])
            each.scene.put("box", *geometry.box((-20, -20, 90), (-19, -19, 91)))
        points = np.concatenate([[start], np.array(start) + np.random.default_rng(1).normal(0, 0.02, (50, 3))])
        bits = [each.light_bits(points, [sun])[0] for each in (tracer, hard)]
        np.testing.assert_array_equal(*bits)
        assert int(bits[0][0]).bit_count() == 63


def test_behind_a_light_nothing_of_it_is_seen(any_device: str) -> None:
    """Behind one that shines to one side, and in its plane, is OUTSIDE, but for its very centre; a light that shines to
    both sides is seen edge-on."""
    tracer = ShadowTracer("light_grid", device=any_device, bounds=Bounds(**_SMALL))
    points = np.array([(0.0, 0.0, 0.5), (0.0, 0.0, 1.0), (5.0, 0.0, 1.0), (0.25, 0.5, 2.0), (0.0, 0.0, np.nan)])
    panel = (0.0, 0.0, 1.0), (0.0, 0.5, 0.0), (0.5, 0.0, 0.0)
    for light in (RectangleLight("l", *panel), DiscLight("l", panel[0], (0, 0, -1), 0.5)):
        states = tracer.states_at(points, [light])[0]
        assert states.tolist() == [State.LIT, State.LIT, State.OUTSIDE, State.OUTSIDE, State.INVALID]
        full = 2**64 - 1
        assert tracer.light_bits(points, [light])[0].tolist() == [full, full, 0, 0, 0]
        np.testing.assert_array_equal(tracer.visibility(points, [light])[0], [1.0, 1.0, 0.0, 0.0, np.nan])
    both = RectangleLight("l", *panel, two_sided=True, range=4.0)
    assert tracer.states_at(points, [both])[0].tolist() == [0, 0, State.OUTSIDE, 0, State.INVALID]


def test_more_points_than_bits(reference: Any) -> None:
    many = SphereLight("ball", (0.0, 0.0, 3.0), 0.5, samples=65)
    with pytest.raises(ValueError, match=r"^lights\[0\]: expected.*64 points.*65"):
        reference.light_bits((0.0, 0.0, 0.0), [many])
    frame = reference.trace(np.ones((2, 3), np.float32), Camera(3, 2, 3.0, 3.0, 1.0, 0.5), [many])
    with pytest.raises(ValueError, match="^name: expected.*64 points.*65"):
        frame.light_bits("ball")
    assert (frame.visibility("ball") == 1.0).all()
    with pytest.raises(ValueError, match="^name:"):
        frame.light_bits("moon")


@pytest.mark.parametrize("shape", [(), (0,), (2, 3), (701,)])
def test_shapes_and_pieces(reference: Any, any_device: str, shape: tuple[int, ...]) -> None:
    """Any leading shape; more points than there is room for at once."""
    tracer = ShadowTracer("mesh_bvh", device=any_device, bounds=Bounds(**{**_SMALL, "max_rays": 100}))
    for each in (tracer, reference):
        each.scene.put("scene", *_scene())
    points = np.random.default_rng(175).uniform(-3, 3, (*shape, 3))
    lights = [_LAMPS[0], _LAMPS[5]]
    bits, share = tracer.light_bits(points, lights, _BIAS), tracer.visibility(points, lights, _BIAS)
    assert bits.shape == share.shape == (2, *shape)
    np.testing.assert_array_equal(bits, reference.light_bits(points, lights, _BIAS))
    with pytest.raises(ValueError, match=r"^bias\.constant:"):
        tracer.visibility(points, lights, -1.0)
    assert math.isfinite(float(share.sum()))
