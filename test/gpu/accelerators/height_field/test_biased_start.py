# SPDX-License-Identifier: Apache-2.0
"""Rays go into a chart from where their bias ends: surfaces at the bias and next to it, samples far from the chart,
where a small part of the bias is many cells, biases of all sizes, lights everywhere."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import pytest
import surfaces
from surfaces import agree, moved, turned

from shadow_tracer import Camera, DirectionalLight, HeightField, PointLight
from shadow_tracer.gpu.accelerators.height_field import charts

pytestmark = probe.in_both_forms

_WAY = np.array([3.0, 4.0, 12.0])  # 13 long
_PARTS = (0.0, 1e-12, 1e-10, 3e-9, 1e-8, 1e-7, 1e-5)  # of the bias, by which it is more or less than the distance


@pytest.fixture(autouse=True)
def _small_surfaces_have_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)


@pytest.mark.parametrize("away", [1.0, 1e3, 1e5])
@pytest.mark.parametrize("kind", ["sun", "lamp"])
def test_surfaces_at_the_bias(any_device: str, kind: str, away: float) -> None:
    """Flat ground, and a peak, which makes the steps of heights so coarse that samples so far away are not too far."""
    z = np.zeros((9, 9))
    z[0, 0] = 7.0
    field = HeightField(z, 1.0, origin=(0.0, 8.0, 0.0))
    met = np.array([[2.25, 5.5, 0.0], [3.0, 4.0, 0.0], [6.0, 2.25, 0.0], [7.5, 7.75, 0.0]])
    points, hidden = met - away * _WAY, []
    for part in _PARTS:
        for more in (1.0 + part, 1.0 - part):
            for number, place in enumerate(met):
                light: Any = DirectionalLight("sun", -_WAY)
                if kind == "lamp":
                    light = PointLight("lamp", place + 2.0 * away * _WAY)
                states, counters, tracer = agree(
                    any_device, lambda scene: scene.put_surface("ground", field), points, [light], 13.0 * away * more
                )
                hidden.append(states[0, number] == 1)
                assert counters["leaf_tests"] < 30 * len(points), "all quads are shown"
    assert probe.charts(tracer)[0] == ["ground"] and 0.2 < np.mean(hidden) < 0.8


@pytest.mark.parametrize("length", [2e-30, 1e-3, 1.0, 1e3, 5e29])
def test_the_way_to_a_sun_has_any_length(any_device: str, length: float) -> None:
    rng = np.random.default_rng(31)
    field = HeightField(surfaces.terrain(rng, 18, 18), 1.0)
    points = surfaces.around(rng, field.positions(), 200)
    sun = DirectionalLight("sun", np.array([0.75, -0.5, -0.25]) * length)
    for bias in (0.1, 2.0):
        states, _, _ = agree(any_device, lambda scene: scene.put_surface("ground", field), points, [sun], bias)
        assert 0.02 < (states == 1).mean() < 0.9


@pytest.mark.parametrize("bias", [0.0, 1e-6, 0.02, 0.3, 2.0, 40.0])
def test_depth_images_and_biases(any_device: str, bias: float) -> None:
    """Lights in front of the camera, behind it, at its side, nearer than the bias; samples at corners, between them,
    behind the surface and behind the camera."""
    rng = np.random.default_rng(32)
    pose = turned(2.0, (1, 2, -0.5), (40.0, -7.0, 2.0))
    positions = surfaces.depth_surface(rng, 31, 43)
    depth = positions[..., 2].astype(np.float32)
    depth[rng.random(depth.shape) < 0.03] = 0.0
    camera = Camera(43, 31, 43.0, 43.0, 21.0, 15.0, pose)
    z = np.where(depth > 0.0, depth, 3.0)
    corners = camera.unproject(z.astype(np.float64)).reshape(-1, 3)
    near = corners[::3] + 0.1 * rng.normal(size=corners[::3].shape)
    points = np.concatenate([corners, near, pose[:3, 3] + 3.0 * rng.normal(size=(200, 3))])
    ways = [(0, 0, 1), (0, 0, -1), (1, 0.1, 0), (1, 1, 0.2), (-0.2, 0.1, -1), (0.5, 0.7, 1.0)]
    places = [(0.3, 0.1, -2.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.1, 0.0, 0.5), (0.2, 0.1, 4.0), (0, 0, 0)]
    lights: list[Any] = [DirectionalLight(f"sun {k}", pose[:3, :3] @ np.array(way)) for k, way in enumerate(ways)]
    lights += [PointLight(f"lamp {k}", moved(pose, np.array(each, float))) for k, each in enumerate(places)]
    states, counters, tracer = agree(
        any_device, lambda scene: scene.put_depth("depth", depth, camera, 1, 0.3), points, lights, bias
    )
    assert probe.charts(tracer)[0] == ["depth"] and (states == 1).any() == (bias < 40.0)
    if 0.02 <= bias:
        assert counters["leaf_tests"] < 6 * counters["rays"], "rays begin at their samples"


def test_a_bias_spares_what_lies_around_the_sample(any_device: str) -> None:
    """Of samples that are the corners of a smooth surface, with a light over it, next to nothing is tested."""
    depth = np.full((41, 41), 2.0, np.float32) + np.arange(41, dtype=np.float32) / 512
    camera = Camera(41, 41, 60.0, 60.0, 20.0, 20.0)
    points = camera.unproject(depth.astype(np.float64)).reshape(-1, 3)
    lamp = PointLight("lamp", (0.2, -0.3, 0.1))

    def show(scene: Any) -> None:
        scene.put_depth("depth", depth, camera, 1, 0.3)

    _, without, _ = agree(any_device, show, points, [lamp], 0.0)
    _, counters, _ = agree(any_device, show, points, [lamp], 0.05)
    assert without["leaf_tests"] > 4 * len(points) and counters["leaf_tests"] == 0
