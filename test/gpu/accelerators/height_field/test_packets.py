# SPDX-License-Identifier: Apache-2.0
"""Rays that go down the nodes of a chart together: pixels in tiles, points in any order, far apart and side by side,
some of which are hidden before others."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import pytest
import surfaces
from surfaces import agree, moved, turned

from shadow_tracer import Bias, Camera, DirectionalLight, HeightField, PointLight
from shadow_tracer.gpu.accelerators.height_field import charts

pytestmark = probe.in_both_forms


@pytest.fixture(autouse=True)
def _small_surfaces_have_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)


def _image(seed: int, rows: int, columns: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = surfaces.depth_surface(rng, rows, columns)[..., 2].astype(np.float32)
    depth[rng.random(depth.shape) < 0.04] = 0.0
    return depth


@pytest.mark.parametrize("shape", [(3, 3), (4, 4), (5, 18), (31, 6), (33, 47), (40, 64)])
def test_images_that_hide_themselves(any_device: str, shape: tuple[int, int]) -> None:
    """One after the other on the same tracers, of widths that are tiles and of others; lamps that rays run along rows,
    columns and diagonals to, in the image, behind the camera and at its place."""
    pose = turned(1.3, (1, -2, 0.5), (4.0, -7.0, 2.0))
    places = [(1, 0, 0), (0, -1, 0), (0.5, 0.5, 0), (0.1, 0.05, 1.2), (0.2, -0.1, -2), (0, 0, 0), (0.3, 0.2, 9)]
    lights: list[Any] = [PointLight(f"lamp {k}", moved(pose, np.array(each))) for k, each in enumerate(places)]
    ways = [(0, 0, 1), (1, 0.1, 0), (0.4, 0.6, 1)]
    lights += [DirectionalLight(f"sun {k}", pose[:3, :3] @ np.array(each)) for k, each in enumerate(ways)]
    ours = surfaces.tracer(any_device, "height_field", threads=2)
    theirs = surfaces.tracer(any_device, "brute_force")
    dark = []
    for number, bias in enumerate((0.02, 0.0, Bias(0.01, 0.0, 1.0), 0.3)):
        depth = _image(number, *shape)
        camera = Camera(shape[1], shape[0], 40.0, 40.0, shape[1] / 2, shape[0] / 2, pose)
        frames = []
        for tracer in (ours, theirs):
            tracer.scene.put_depth("depth", depth, camera, 1, 0.3)
            frames.append(tracer.trace(depth, camera, lights, bias))
        assert frames[0].differing(frames[1]) == 0, bias
        dark += [(frames[1].state(light.name) == 1).mean() for light in lights]
    assert probe.charts(ours)[0] == ["depth"] and (shape[0] * shape[1] < 100 or 0.02 < np.mean(dark) < 0.9)


@pytest.mark.parametrize("bias", [0.0, 0.2])
def test_points_far_apart(any_device: str, bias: float) -> None:
    """In a random order and in that of a curve, on a surface so wide that the first go one by one."""
    rng = np.random.default_rng(41)
    field = HeightField(surfaces.terrain(rng, 100, 55), 1.0)
    flat = field.positions()[::3, ::2].reshape(-1, 3)
    near = flat + rng.normal(size=flat.shape) * (0.01, 0.01, 0.3)
    points = np.concatenate([near, rng.permutation(near)])
    lights: list[Any] = [surfaces.sun(20.0, 77.0), surfaces.sun(60.0, 180.0)]
    lights += [PointLight("near", (28.0, -50.0, 9.0)), PointLight("far", (-900.0, 500.0, 300.0))]
    states, _, tracer = agree(any_device, lambda scene: scene.put_surface("ground", field), points, lights, bias)
    assert probe.charts(tracer)[0] == ["ground"] and 0.1 < (states == 1).mean() < 0.9


def test_rays_of_a_packet_that_touch_single_peaks(any_device: str) -> None:
    """Of sixteen rays each the others pass over the ground: peaks in all places of nodes, touched from all sides by
    rays of lengths from nothing to the whole surface."""
    rng = np.random.default_rng(42)
    z = np.zeros((40, 40))
    peaks = rng.permutation(1600)[:100]
    z.reshape(-1)[peaks] = rng.integers(1, 9, 100)
    field = HeightField(z, 1.0)
    tips = field.positions().reshape(-1, 3)[peaks]
    ways = rng.normal(size=(100, 3)) * (1.0, 1.0, 0.1)
    touching = tips - ways * 2.0 ** rng.integers(-6, 4, (100, 1))
    over = np.repeat(touching, 16, axis=0) + rng.normal(size=(1600, 3)) * (3.0, 3.0, 0.0) + (0.0, 0.0, 12.0)
    over[rng.integers(0, 16, 100) + 16 * np.arange(100)] = touching
    lamp = tips[0] + (3.0, 4.0, 0.5)
    hidden = 0
    for light in (PointLight("lamp", lamp), DirectionalLight("sun", (0.5, 0.25, 0.0))):
        away = (tips - lamp) if isinstance(light, PointLight) else np.broadcast_to(light.direction, tips.shape)
        points = over.copy()
        points[16 * np.arange(100) + rng.integers(0, 16, 100)] = tips + away * 2.0 ** rng.integers(-5, 3, (100, 1))
        states, _, _ = agree(any_device, lambda scene: scene.put_surface("peaks", field), points, [light], 1e-3)
        hidden += int((states == 1).sum())
    assert hidden > 100
