# SPDX-License-Identifier: Apache-2.0
"""Rays right over edges, within roundings: over edges between two triangles that both hide, one of both does, and
neither needs exact arithmetic; over ridges, where it is for that to say."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import pytest
import surfaces
from surfaces import agree, moved, turned

from shadow_tracer import DirectionalLight, HeightField, PointLight
from shadow_tracer.gpu.accelerators.height_field import charts

pytestmark = probe.in_both_forms

_POSE = turned(0.7, (1, 2, -0.5), (5.0, -3.0, 2.0))
_PIPELINES = pytest.mark.parametrize("pipeline", ["height_field", "geometry_image"])


@pytest.fixture(autouse=True)
def _small_surfaces_have_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)


def _on_edges(rng: np.random.Generator, world: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(N, 3) places on edges along rows, columns and diagonals that begin at these positions."""
    ways = rng.integers(0, 3, len(rows))
    ends = world[rows + (ways != 0), columns + (ways != 1)]
    part = rng.uniform(0.1, 0.9, (len(rows), 1))
    return world[rows, columns] * (1.0 - part) + ends * part


def _behind(places: np.ndarray, light: Any, far: np.ndarray) -> np.ndarray:
    """Samples whose rays go through places, so far behind them."""
    if isinstance(light, PointLight):
        return places + (places - light.position) * far
    return places + np.array(light.direction) * far


@_PIPELINES
@pytest.mark.parametrize("cull", [False, True])
def test_edges_that_triangles_share(any_device: str, kernel_form: str, pipeline: str, cull: bool) -> None:
    rng = np.random.default_rng(51)
    field = HeightField(surfaces.terrain(rng, 18, 20, 0.1), 1.0)
    world = moved(_POSE, field.positions().reshape(-1, 3)).reshape(18, 20, 3)
    rows, columns = rng.integers(1, 16, 400), rng.integers(1, 18, 400)
    places = _on_edges(rng, world, rows, columns)
    for light in (
        PointLight("lamp", moved(_POSE, np.array((9.0, -8.0, 11.0)))),
        PointLight("below", moved(_POSE, np.array((9.0, -8.0, -11.0)))),
        DirectionalLight("sun", _POSE[:3, :3] @ np.array((0.3, 0.2, -1.0))),
    ):
        points = _behind(places, light, rng.uniform(0.2, 0.6, (400, 1)))
        for bias in (0.0, 0.02):
            states, counters, _ = agree(
                any_device,
                lambda scene: scene.put_surface("ground", field, pose=_POSE),
                points,
                [light],
                bias,
                cull,
                pipeline=pipeline,
            )
            assert (states == 1).all() or (cull and (states != 1).all())
            if pipeline == "height_field" and any_device == "cpu" and kernel_form == probe.USUAL:
                assert counters["exact"] < 40, "pairs of triangles are decided exactly"


@_PIPELINES
@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_ridges_and_borders(any_device: str, pipeline: str, bias: float) -> None:
    """From a lamp beside it one side of a ridge faces it and one does not, and behind a border there is nothing."""
    rng = np.random.default_rng(52)
    z = np.broadcast_to(-0.5 * np.abs(np.arange(17.0) - 8.0)[:, None], (17, 20))
    field = HeightField(z, 1.0)
    world = moved(_POSE, field.positions().reshape(-1, 3)).reshape(17, 20, 3)
    part, columns = rng.uniform(0.1, 0.9, (500, 1)), rng.integers(0, 19, 500)
    ridge = world[8, columns] * (1.0 - part) + world[8, columns + 1] * part
    border = world[16, columns] * (1.0 - part) + world[16, columns + 1] * part
    lights: list[Any] = [PointLight("lamp", moved(_POSE, np.array((9.0, 20.0, 1.0))))]
    lights.append(DirectionalLight("sun", _POSE[:3, :3] @ np.array((0.1, -1.0, -0.05))))
    for light in lights:
        for places in (ridge, border):
            points = _behind(places, light, rng.uniform(0.1, 0.4, (500, 1)))
            states, _, _ = agree(
                any_device,
                lambda scene: scene.put_surface("ridge", field, pose=_POSE),
                points,
                [light],
                bias,
                pipeline=pipeline,
            )
            assert places is border or 0.1 < (states == 1).mean() < 0.9


@_PIPELINES
def test_edges_at_the_bias(any_device: str, pipeline: str) -> None:
    """Surfaces at the bias and next to it, met on their edges: both triangles are at it, or one is."""
    z = np.zeros((9, 9))
    z[0, 0], z[4:, 4:] = 7.0, 2.0**-30
    field = HeightField(z, 1.0, origin=(0.0, 8.0, 0.0))
    met = np.array([[2.25, 5.0, 0.0], [3.0, 4.0, 0.0], [6.0, 2.25, 0.0], [7.5, 7.5, 0.0], [4.0, 3.25, 0.0]])
    points, way = met - np.array([3.0, 4.0, 12.0]), np.array([3.0, 4.0, 12.0])
    hidden = []
    for part in (0.0, 1e-12, 3e-9, 1e-8, 1e-7):
        for more in (1.0 + part, 1.0 - part):
            for light in (DirectionalLight("sun", -way), PointLight("lamp", met[0] + 2.0 * way)):
                states, _, _ = agree(
                    any_device,
                    lambda scene: scene.put_surface("ground", field),
                    points,
                    [light],
                    13.0 * more,
                    pipeline=pipeline,
                )
                hidden.append((states == 1).mean())
    assert min(hidden) < 0.5 < max(hidden)


@_PIPELINES
def test_many_open_edges(any_device: str, pipeline: str) -> None:
    """A ray along a border of six walls, which it meets in one of them, and misses by the last bit in the others."""
    columns, walls = 27, np.arange(2, 26, 4)
    for met in (-1, *range(6)):
        positions = np.zeros((3, columns, 3))
        positions[..., 0], positions[..., 1] = np.arange(columns), np.arange(3.0)[:, None]
        valid = np.ones((3, columns), bool)
        for number, column in enumerate(walls):
            around = slice(column - 1, column + 2)
            positions[1:, column, 2] = 2.0
            valid[0, around] = False
            if number != met:
                positions[1, around, 1] += 2.0**-52
        lamp = PointLight("lamp", (200.0, 1.0, 1.0))
        points = np.array([[-0.5, 1.0, 1.0], [-2.0, 1.0, 1.0]])

        def show(scene: Any, positions: np.ndarray = positions, valid: np.ndarray = valid) -> None:
            scene.put_surface("walls", positions, valid)

        states, _, _ = agree(any_device, show, points, [lamp], pipeline=pipeline)
        assert (states == (met >= 0)).all()
