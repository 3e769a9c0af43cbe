# SPDX-License-Identifier: Apache-2.0
"""Positions that all lights of a frame share, in the form of the CPU: what rays that are made of them are off by is
within what docs/exactness.md derives, scenes that need what bounds grow by for it, samples for which they are not good
enough, and frames of all kinds one after the other."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import packed_grid
import probe
import probe_accelerators
import pytest

from shadow_tracer import Bias, Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight
from shadow_tracer.gpu.exact.light_frame import make_light_frame
from shadow_tracer.scene.lights import Light

pytestmark = pytest.mark.wide

_U = 2.0**-24


def _pair(bounds: Bounds, threads: int = 1) -> tuple[ShadowTracer, ShadowTracer]:
    grid = ShadowTracer("light_grid", "packed", "cpu", bounds, threads=threads)
    return grid, ShadowTracer("brute_force", "filtered", "cpu", bounds, threads=1)


def _put(tracers: tuple[ShadowTracer, ...], vertices: np.ndarray, triangles: np.ndarray) -> None:
    for tracer in tracers:
        tracer.scene.put("mesh", vertices, triangles)


def _check(tracers: tuple[ShadowTracer, ...], points: np.ndarray, light: Light, bias: float) -> np.ndarray:
    one, two = (tracer.occluded(points, light, bias) for tracer in tracers)
    np.testing.assert_array_equal(one, two)
    return two


def _exact_rays(samples: np.ndarray, light: Light, tracer: ShadowTracer) -> np.ndarray:
    """(N, 4) in extended precision, of (N, 4) samples and biases."""
    frame = make_light_frame(light, probe.anchor(tracer))
    p, beta = samples[:, :3].astype(np.longdouble), samples[:, 3].astype(np.longdouble)
    place = np.array(frame.light, np.longdouble)
    way = place[:3] - place[3] * p
    start = p + (beta / np.sqrt((way**2).sum(axis=1)))[:, None] * way
    start = (start - np.array(frame.center)) * np.longdouble(frame.inverse_scale)
    u, v, z = (start @ np.array(axis, np.longdouble) for axis in (frame.r, frame.s, frame.f))
    return np.stack([u, v, frame.w_constant - frame.w_slope * z, z], axis=-1)


_LIGHTS: dict[str, Light] = {
    "inside": PointLight("lamp", (0.1, 0.2, 2.6)),
    "outside": PointLight("lamp", (3.0, -4.0, -1.0)),
    "far": PointLight("lamp", (3e6, -4e6, -1e6)),
    "sun": DirectionalLight("lamp", (-0.3, 0.4, 0.8)),
}


@pytest.mark.parametrize("bias", [0.0, 1e-6, 0.02, 0.2])
@pytest.mark.parametrize("name", _LIGHTS)
def test_rays_are_off_by_less_than_was_derived(name: str, bias: float) -> None:
    rng = np.random.default_rng(490)
    camera = Camera(96, 64, 60.0, 60.0, 47.5, 31.5, geometry.pose_of(geometry.rotation(rng), (0.0, 0.0, 0.0)))
    light = _LIGHTS[name]
    tracer = ShadowTracer("light_grid", "packed", "cpu", Bounds(400, 96 * 64, 1), threads=1)
    tracer.scene.put("mesh", *geometry.soup(rng, 120, 0.3, 1.5))
    tracer.trace(rng.uniform(1.0, 4.0, (64, 96)).astype(np.float32), camera, [light], bias)
    pipeline, samples = probe.pipeline(tracer), probe.context(tracer).samples
    packed = packed_grid.read(probe_accelerators.tiles(pipeline))
    tile, lane = np.nonzero(probe_accelerators.kept_live(pipeline, len(packed.live)))
    number = packed.order[tile, lane]
    step = samples.positions.numpy()[number, 3] * make_light_frame(light, probe.anchor(tracer)).inverse_scale
    exact = _exact_rays(samples.positions.numpy()[number], light, tracer)
    off = np.abs(packed.rays[tile, lane] - exact)
    assert (off <= _U * np.abs(exact) * (1.0 + 1e-6) + (1.73 * 2.0**-32 + 6.2 * _U * step)[:, None]).all()
    if bias == 0.0 and name != "far":  # float64 would not be off by so much
        assert (off[:, 3] > _U * np.abs(exact[:, 3]) + 2.0**-36).any()


@pytest.mark.parametrize("apart", [False, True])
def test_planes_between_samples_that_steps_do_not_tell(apart: bool) -> None:
    """Samples beside the anchor, a fraction of a step from each other, and a triangle whose plane goes between them:
    their magnitudes are so small that bounds are smaller than a step. With others far away in their piece, and
    without."""
    rng = np.random.default_rng(491)
    corners = np.array([(x, y, z) for x in (-2.0, 2.0) for y in (-2.0, 2.0) for z in (-2.0, 2.0)])
    lamp = PointLight("lamp", (5.0, 4.0, -3.0))
    tracers = _pair(Bounds(4, 128, 1))
    _put(tracers, np.eye(3) * 1e3 + 1e6, np.array([[0, 1, 2]]))
    points = np.tile(corners, (8, 1))
    tracers[0].occluded(points, lamp, 0.0)
    anchor = probe.anchor(tracers[0])
    middle, step = np.array(anchor.center), anchor.scale * 2.0**-31
    way = geometry.unit(lamp.position - middle)
    hidden = 0
    for _ in range(20):
        few = middle + step * rng.uniform(-1.0, 1.0, (28, 1)) * way
        points[4 if apart else 32 :][:28] = few
        normal = geometry.unit(way + 0.3 * rng.normal(size=3))
        one = geometry.unit(np.cross(normal, rng.normal(size=3)))
        two = np.cross(normal, one)
        place = middle + step * rng.uniform(-0.5, 0.5) * way
        _put(tracers, place + np.array([one, 0.9 * two - 0.5 * one, -0.9 * two - 0.5 * one]), np.array([[0, 1, 2]]))
        found = _check(tracers, points, lamp, 0.0)[4 if apart else 32 :][:28]
        hidden += int(found.sum())
        np.testing.assert_array_equal(probe.anchor(tracers[0]).center, anchor.center)
    assert 100 < hidden < 20 * 28 - 100


@pytest.mark.parametrize("distance", [2.0**-25, 2.0**-16, 2.0**-15, 2.0**-10, 2.0**-5])
def test_directions_of_samples_near_the_light(distance: float) -> None:
    """Tiles that hold a single direction each, and triangles that fill a 2^-20 of a radian of it; ``distance`` in units
    of the anchor's scale."""
    rng = np.random.default_rng(497)
    lamp = PointLight("lamp", (0.125, -0.25, 0.375))
    tracers = _pair(Bounds(4, 96, 1))
    _put(tracers, np.eye(3) * 1e3 + 1e6, np.array([[0, 1, 2]]))
    corners = np.array([(x, y, z) for x in (-2.0, 2.0) for y in (-2.0, 2.0) for z in (-2.0, 2.0)])
    points = np.tile(corners, (12, 1))
    tracers[0].occluded(points, lamp, 0.0)
    away = distance * probe.anchor(tracers[0]).scale
    for _ in range(20):
        ways = geometry.directions(rng, 2)
        points[32:] = np.repeat(lamp.position + away * ways, 32, axis=0)
        spans = rng.normal(size=(2, 2, 3))
        three = np.stack([spans[:, 0], spans[:, 1], -spans[:, 0] - spans[:, 1]], axis=1)
        vertices = lamp.position + 0.9 * away * (ways[:, None] + 2.0**-20 * three)
        _put(tracers, vertices.reshape(-1, 3), np.arange(6).reshape(2, 3))
        assert _check(tracers, points, lamp, 0.0)[32:].mean() >= 0.5


def _settings() -> dict[str, tuple[np.ndarray, Light, float]]:
    """Points, light and bias."""
    rng = np.random.default_rng(492)
    wide = rng.uniform(-2.0, 2.0, (64, 3))
    lamp = PointLight("lamp", (0.125, -0.25, 0.375))
    near = lamp.position + rng.uniform(-1.0, 1.0, (32, 3)) * 10.0 ** rng.uniform(-9.0, -2.0, (32, 1))
    around = lamp.position + rng.uniform(0.2, 0.6, (32, 1)) * geometry.directions(rng, 32)
    far = wide[:32] * 10.0 ** rng.uniform(0.0, 12.0, (32, 1))
    return {
        "near the light": (np.concatenate([wide, near]), lamp, 0.0),
        "far away": (np.concatenate([wide, far]), lamp, 0.01),
        "rays that begin behind the light": (np.concatenate([around, wide]), lamp, 0.9),
        "rays that begin far off": (wide, DirectionalLight("lamp", (0.3, -0.4, 0.5)), 4.0),
        "beyond a range": (wide, PointLight("lamp", (0.1, 0.2, 0.3), range=1.5), 0.01),
        "beside a cone": (wide, SpotLight("lamp", (0.0, 0.0, -3.0), (0.0, 0.1, 1.0), 0.3), 0.01),
    }


@pytest.mark.parametrize("kind", _settings())
def test_samples_that_positions_are_not_good_enough_for(kind: str) -> None:
    points, light, bias = _settings()[kind]
    rng = np.random.default_rng(493)
    tracers = _pair(Bounds(4000, 128, 1))
    for size, spread in [(0.5, 1.5), (0.02, 0.1), (1e-4, 1e-3)]:
        vertices, triangles = geometry.soup(rng, 400, size, spread)
        shift = light.position if isinstance(light, PointLight) and size < 0.1 else np.zeros(3)
        _put(tracers, vertices + shift, triangles)
        _check(tracers, points, light, bias)
        _check(tracers, points[::-1].copy(), light, bias)


def test_measurements_far_beyond_the_others() -> None:
    rng = np.random.default_rng(496)
    camera = Camera(96, 64, 90.0, 90.0, 47.5, 31.5)
    grid, other = _pair(Bounds(400, 96 * 64, 2))
    vertices, triangles = geometry.soup(rng, 300, 0.5, 1.5)
    _put((grid, other), vertices + [0.0, 0.0, 2.0], triangles)
    depth = rng.uniform(2.0, 4.0, (64, 96)).astype(np.float32)
    far = rng.random(depth.shape) < 0.002
    depth[far] *= 10.0 ** rng.uniform(1.0, 6.0, int(far.sum())).astype(np.float32)
    lights = [PointLight("lamp", (0.3, -0.2, -3.5)), DirectionalLight("sun", (0.3, -0.4, 0.8))]
    frames = [tracer.trace(depth, camera, lights, 0.01) for tracer in (grid, other)]
    samples, anchor = probe.context(grid).samples, probe.anchor(grid)
    away = np.abs(samples.positions.numpy()[: depth.size, :3] - anchor.center).max(axis=1) > anchor.scale
    assert away.sum() > 5
    for light in lights:
        np.testing.assert_array_equal(frames[0].state(light.name), frames[1].state(light.name))


def test_one_ray_beyond_the_frustum() -> None:
    """Found by none of the samples that are looked at first: all pieces before it go to the faces of the cube, and many
    have rays beyond the face that the frustum is on."""
    rng = np.random.default_rng(495)
    light, camera = PointLight("lamp", (0.0, 0.0, 1.2)), Camera(96, 64, 90.0, 90.0, 47.5, 31.5)
    grid, other = _pair(Bounds(400, 96 * 64, 1))
    vertices, triangles = geometry.soup(rng, 300, 0.5, 1.5)
    _put((grid, other), vertices + [0.0, 0.0, 2.0], triangles)
    depth = rng.uniform(2.0, 4.0, (64, 96)).astype(np.float32)
    aligned = []
    for row in (None, 63, 33, 1):
        image = depth.copy()
        if row is not None:
            image[row, 95] = 0.3  # behind the light
        frames = [tracer.trace(image, camera, [light], 0.0) for tracer in (grid, other)]
        np.testing.assert_array_equal(frames[0].state("lamp"), frames[1].state("lamp"))
        aligned.append(int(probe_accelerators.tiles(probe.pipeline(grid)).aligned.numpy()[0]))
    assert aligned == [1, 0, 0, 0]


def _scenes(rng: np.random.Generator) -> list[tuple[str, Any, list[Light], Any]]:
    """Images and points of a few shapes, of few and many lights, some of them those of before."""
    lights = [PointLight(f"lamp {k}", rng.uniform(-1.5, 1.5, 3) + [0.0, 0.0, 2.0]) for k in range(5)]
    lights[3] = SpotLight("lamp 3", (0.3, -0.5, 0.5), (0.0, 0.1, 1.0), 0.4)
    found: list[tuple[str, Any, list[Light], Any]] = []
    for number in range(24):
        width, height = [(96, 64), (64, 96), (70, 33), (9, 5)][rng.integers(4)]
        some = [lights[k] for k in np.sort(rng.choice(5, int(rng.integers(1, 6)), replace=False))]
        if number % 5 == 4:
            found.append(("points", rng.uniform(-2.0, 2.0, (int(rng.integers(1, 3000)), 3)), some, 0.01))
            continue
        depth = rng.uniform(1.0, 4.0, (height, width)).astype(np.float32)
        depth[rng.random(depth.shape) < 0.1] = np.nan
        if number % 7 == 6:
            depth[3, 3] = 1e7
        found.append(("image", depth, some, [0.01, Bias(0.002, 0.001), 0.0][rng.integers(3)]))
        if number % 3 == 2:
            found.append((*found[-1][:2], [lights[k] for k in range(int(rng.integers(1, 6)))], found[-1][3]))
    return found


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("at_once", [1, 10**6])
def test_sequences_of_passes(at_once: int, threads: int) -> None:
    """One pass for each light, or one for all: positions are made by the first pass and taken by the others, if there
    are others; and not those of another image, bias, or set of points."""
    rng = np.random.default_rng(494)
    grid, other = _pair(Bounds(400, 5 * 96 * 64, 5), threads)
    for band in probe.bands(grid):
        probe_accelerators.limit_rays_at_once(band.pipeline, at_once)
    vertices, triangles = geometry.soup(rng, 120, 0.4, 1.5)
    for kind, what, lights, bias in _scenes(rng):
        if kind == "points":
            for light in lights:
                _put((grid, other), vertices + rng.uniform(-0.1, 0.1, 3) + [0.0, 0.0, 1.5], triangles)
                _check((grid, other), what, light, bias)
            continue
        _put((grid, other), vertices + rng.uniform(-0.1, 0.1, 3) + [0.0, 0.0, 1.5], triangles)
        height, width = what.shape
        camera = Camera(width, height, 50.0, 50.0, 0.5 * width - 0.5, 0.5 * height - 0.5)
        frames = [tracer.trace(what, camera, lights, bias) for tracer in (grid, other)]
        for light in lights:
            np.testing.assert_array_equal(frames[0].state(light.name), frames[1].state(light.name))
        assert frames[0].counters["rays"] == frames[1].counters["rays"]
