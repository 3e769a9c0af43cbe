# SPDX-License-Identifier: Apache-2.0
"""Triangles that may concern the rays of a band: none that hides one is left out, most others are, and records are made
for rays outside of the tiles alone."""

from __future__ import annotations

from functools import cache

import geometry
import numpy as np
import probe
import probe_accelerators
import pytest

from shadow_tracer import Bounds, DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.scene.lights import Light

_DISTANCES = (0.5, 3.0, 1.0e4, 1.0e8, np.inf)


def _tracer(pipeline: str) -> ShadowTracer:
    return probe.reset(_shared(pipeline))


@cache
def _shared(pipeline: str) -> ShadowTracer:
    return ShadowTracer(pipeline, device="cpu", bounds=Bounds(max_triangles=8192, max_rays=4096, max_lights=2))


def _specks(rng: np.random.Generator, way: np.ndarray, middle: np.ndarray, size: float) -> np.ndarray:
    """(16, 3, 3) triangles as small as ``size`` around a point of a way."""
    along = np.cross(way, rng.normal(size=3))
    along /= np.linalg.norm(along)
    across = np.cross(way, along)
    across /= np.linalg.norm(across)
    angle = 2.0 * np.pi * (np.arange(3) / 3.0 + rng.uniform(0.0, 1.0, (16, 1)))
    corners: np.ndarray = middle + size * (np.cos(angle)[..., None] * along + np.sin(angle)[..., None] * across)
    return corners


def _same(points: np.ndarray, corners: np.ndarray, light: Light, bias: float) -> np.ndarray:
    """The answers of brute force, which are those of the light grid, too."""
    answers = []
    for pipeline in ("light_grid", "brute_force"):
        tracer = _tracer(pipeline)
        tracer.scene.put("specks", corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))
        answers.append(tracer.occluded(points, light, bias=bias))
    assert np.array_equal(*answers), f"{points[answers[0] != answers[1]]} and {corners[:2]}"
    expected: np.ndarray = answers[1]
    return expected


@pytest.mark.parametrize("distance", _DISTANCES)
@pytest.mark.parametrize("seed", range(2))
def test_specks_on_the_outermost_ray(distance: float, seed: int) -> None:
    """Of two rays both are at the edge of the pyramid. The specks are so small, and so near the world's origin, that
    nothing but what is allowed for rounding keeps them in it."""
    rng = np.random.default_rng([481, seed])
    hidden = 0
    for _ in range(100):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        length = distance if np.isfinite(distance) else 5.0
        part = rng.choice([0.1, 0.5, 0.9]) if distance < 10.0 else rng.uniform(0.1, 2.0) / length
        points = np.stack([-part * length * way, -part * length * way])
        points[1] += rng.uniform(0.2, 1.0) * np.cross(way, rng.normal(size=3))
        light: Light = DirectionalLight("lamp", tuple(-way))
        if np.isfinite(distance):
            light = PointLight("lamp", tuple((1.0 - part) * length * way))
        hidden += int(_same(points, _specks(rng, way, np.zeros(3), 1e-12 * length), light, 1e-6)[0])
    assert hidden > 50, "the specks are to hide the sample"


@pytest.mark.parametrize("seed", range(3))
def test_specks_on_ways_from_all_around(seed: int) -> None:
    """All faces, and samples on the other side of the light than their middle is."""
    rng = np.random.default_rng([483, seed])
    lamp = rng.uniform(-1.0, 1.0, 3)
    points = lamp + rng.normal(size=(40, 3)) * rng.uniform(0.2, 3.0, (40, 1))
    points[::2] += (0.0, 4.0, 0.0)
    parts = rng.choice([0.01, 0.2, 0.6, 0.95, 0.999], (40, 1))
    middles = points + parts * (lamp - points)
    corners = np.concatenate([_specks(rng, lamp - p, m, 1e-4) for p, m in zip(points, middles, strict=True)])
    assert _same(points, corners, PointLight("lamp", tuple(lamp)), 1e-6).sum() > 30


def _clusters(tracer: ShadowTracer) -> int:
    """That the band looked at."""
    return len(probe_accelerators.clusters(probe.pipeline(tracer)))


def _blocks(tracer: ShadowTracer) -> int:
    """Of which there are records."""
    return int(probe_accelerators.blocks_made(probe.pipeline(tracer)).sum())


def _far_and_near(seed: int = 482) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A small sheet of 512 triangles near some samples, and 7,168 triangles elsewhere, in clumps."""
    rng = np.random.default_rng(seed)
    vertices, triangles = geometry.soup(rng, 512, 0.05, 0.4)
    clumps = rng.normal(size=(448, 3))
    clumps *= 5.0 / np.linalg.norm(clumps, axis=1)[:, None]
    clumps = clumps[clumps[:, 2] < 1.0]
    far = np.concatenate([middle + 0.2 * rng.uniform(-1.0, 1.0, (48, 3)) for middle in clumps])
    triangles = np.concatenate([triangles, len(vertices) + np.arange(len(far)).reshape(-1, 3)])
    points = np.column_stack([rng.uniform(-0.9, 0.9, (600, 2)), np.full(600, -0.6)])
    return np.concatenate([vertices, far]), triangles, points


@pytest.mark.wide
def test_only_what_may_concern_the_rays_is_looked_at() -> None:
    vertices, triangles, points = _far_and_near()
    tracer, oracle = _tracer("light_grid"), _tracer("brute_force")  # without an anchor yet
    light = PointLight("lamp", (0.1, 0.0, 1.2))
    wide = np.concatenate([points, points + (0.0, -8.0, 0.0)])

    def check(samples: np.ndarray, lamp: Light) -> int:
        found = tracer.occluded(samples, lamp, bias=1e-3)
        assert np.array_equal(found, oracle.occluded(samples, lamp, bias=1e-3))
        return int(found.sum())

    for each in (tracer, oracle):
        each.scene.put("specks", vertices, triangles)
    check(wide, light)  # the anchor of these serves the others, too
    for each in (tracer, oracle):
        each.scene.deform("specks", vertices + (0.0, 0.01, 0.0))
    assert 0 < check(points, light) < len(points)
    some = _clusters(tracer)
    assert 512 // 16 <= some < 80, "of 16 triangles each, of 480"
    # The same light and scene, other samples: more is looked at.
    check(wide, light)
    assert _clusters(tracer) > some
    # Another mesh, then another light: nothing of the old is believed.
    for each in (tracer, oracle):
        each.scene.deform("specks", vertices[::-1].copy())
    check(points, light)
    assert 0 < _clusters(tracer) < len(triangles) // 16
    check(wide, PointLight("lamp", (-0.4, 0.3, 0.9)))
    assert _blocks(tracer) == 0


@pytest.mark.wide
def test_rays_outside_of_the_tiles_are_shown_everything() -> None:
    """A sample within 2^-22 of the light does not fit into light space; another is there so that there are tiles.
    Records are made of all triangles, and again when the mesh or the light is another."""
    vertices, triangles, points = _far_and_near()
    light = PointLight("lamp", (0.1, 0.0, 1.2))
    tracer, oracle = _tracer("light_grid"), _tracer("brute_force")
    records = probe.context(tracer).records.memory

    def check(lamp: PointLight) -> bool:
        """Whether the first record was made again."""
        near = np.asarray(lamp.position) + (0.0, 0.0, -1e-9)
        samples = np.concatenate([points[:50], near[None]])
        records.numpy()[0, 0] = 7.0
        found = tracer.occluded(samples, lamp, bias=1e-12)
        assert np.array_equal(found, oracle.occluded(samples, lamp, bias=1e-12))
        assert _blocks(tracer) == -(-len(triangles) // 128)
        return not (records.numpy()[0, 0] == 7.0).all()

    for each in (tracer, oracle):
        each.scene.put("specks", vertices, triangles)
    assert check(light)
    assert not check(light)
    for each in (tracer, oracle):
        each.scene.deform("specks", vertices[::-1].copy())
    assert check(light)
    assert check(PointLight("lamp", (-0.4, 0.3, 0.9)))
