# SPDX-License-Identifier: Apache-2.0
"""Clusters of sixteen triangles that go to the tiles together: the same bits whatever lies in a cluster, and the way
that is shared is taken where it should be."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.light_grid import blocks

pytestmark = pytest.mark.wide

_LIGHTS = {
    "inside": PointLight("inside", (0.1, 0.2, 1.1)),
    "outside": PointLight("outside", (3.0, -4.0, -1.0)),
    "far": PointLight("far", (3e4, -2e4, -4e4)),
    "sun": DirectionalLight("sun", (-0.3, 0.4, 0.8)),
}


class View(NamedTuple):
    vertices: np.ndarray
    triangles: np.ndarray
    depth: np.ndarray


_CAMERA = Camera(160, 120, 90.0, 90.0, 79.5, 59.5)


def _sheet(rng: np.random.Generator, n: int, middle: tuple[float, float, float]) -> geometry.Geometry:
    """2 n^2 small triangles side by side over 2 x 2 m: sixteen that follow each other lie in a row."""
    at = np.linspace(-1.0, 1.0, n + 1)
    x, y = np.meshgrid(at, at)
    vertices = np.stack([x, y, rng.uniform(-0.02, 0.02, x.shape)], axis=-1).reshape(-1, 3) + middle
    corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    quads = [corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]]
    a, b, c, d = (quad.ravel() for quad in quads)
    return vertices, np.stack([a, b, c, b, d, c], axis=1).reshape(-1, 3)


def _mixed(rng: np.random.Generator) -> geometry.Geometry:
    """A sheet of which every fifth triangle is another one: as large as the view, across the light's plane, far behind
    the light, without area, or seen edge-on."""
    vertices, triangles = _sheet(rng, 15, (0.0, 0.0, 1.8))
    corners = vertices[triangles]
    for k in range(0, len(corners), 5):
        a, kind = corners[k, 0], k // 5 % 5
        if kind == 0:
            corners[k] = a + rng.normal(0.0, 1.5, (3, 3))
        elif kind == 1:  # a corner on the other side of the lamp inside
            corners[k, 2] = a + [0.0, 0.0, -rng.uniform(0.6, 1.5)]
        elif kind == 2:
            corners[k] -= [0.0, 0.0, 5.0]
        elif kind == 3:
            corners[k, 2] = corners[k, 1]
        else:
            corners[k, 2] = a + 0.5 * (a - _LIGHTS["inside"].position)
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _across(rng: np.random.Generator) -> geometry.Geometry:
    """Of sixteen that lie together every other one goes past the lamp inside, with a corner behind it on the line
    through another: divided by W the three are near each other, and what they hide is far from there."""
    lamp = np.array(_LIGHTS["inside"].position)
    a = np.repeat(rng.uniform(-0.5, 0.5, (20, 3)) + lamp + [0.0, 0.0, 1.0], 16, axis=0)
    behind = lamp - 0.5 * (a - lamp)
    corners = np.stack([a, a, behind], axis=1) + rng.normal(0.0, 0.03, (len(a), 3, 3))
    corners[::2, 2] = a[::2] + rng.normal(0.0, 0.03, (len(a) // 2, 3))
    return corners.reshape(-1, 3), np.arange(3 * len(a)).reshape(-1, 3)


@cache
def _view(kind: str) -> tuple[View, np.ndarray]:
    """160 x 120 pixels before some meshes, four lights; what brute force says."""
    rng = np.random.default_rng(480)
    if kind in ("mixed", "across"):
        meshes = [_mixed(rng) if kind == "mixed" else _across(rng)]
    elif kind == "sheets":  # behind each other, the last cluster of each is not full
        meshes = [_sheet(rng, 19, (0.4 * k, 0.3 * k, 1.5 + 0.7 * k)) for k in range(-1, 2)]
    else:
        meshes = [_sheet(rng, 19, (0.0, 0.0, 1.6)), geometry.soup(rng, 60, 1.0, 1.0)]
    vertices, triangles = geometry.join(meshes)
    depth = rng.uniform(1.9, 4.0, (120, 160)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0.0
    view = View(vertices, triangles, depth)
    return view, _traced(ShadowTracer("brute_force", "filtered", "cpu", _bounds(), threads=1), view)[0]


def _bounds(**more: int) -> Bounds:
    return Bounds(**{"max_triangles": 3_000, "max_rays": 160 * 120, "max_lights": 4, **more})


def _traced(tracer: ShadowTracer, view: View, order: Any = slice(None)) -> tuple[np.ndarray, dict[str, int]]:
    tracer.scene.put("mesh", view.vertices, view.triangles[order])
    frame = tracer.trace(view.depth, _CAMERA, list(_LIGHTS.values()), 0.01)
    return np.stack([frame.state(light.name) for light in _LIGHTS.values()]), frame.counters


@pytest.mark.parametrize("entries", [1, 40, 100_000])
@pytest.mark.parametrize("kind", ["sheets", "mixed", "across", "sheet and soup"])
def test_clusters_of_all_kinds(kind: str, entries: int) -> None:
    view, expected = _view(kind)
    assert ((expected == 1).mean(axis=(1, 2)) > 0.02).all(), "a bad test scene"
    tracer = ShadowTracer("light_grid", "packed", "cpu", _bounds(grid_entries=entries), threads=1)
    rng = np.random.default_rng(481)
    count = len(view.triangles)
    for order in (np.arange(count), rng.permutation(count), np.roll(np.arange(count), 7), np.arange(count)):
        np.testing.assert_array_equal(_traced(tracer, view, order)[0], expected)


@pytest.mark.parametrize("kind", ["mixed", "sheet and soup"])
def test_clusters_of_which_entries_wait_have_little_room(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """For the records of two of them, while the list of entries has room for all."""
    monkeypatch.setattr(blocks, "_MOST_CLUSTERS", 2)
    view, expected = _view(kind)
    tracer = ShadowTracer("light_grid", "packed", "cpu", _bounds(), threads=1)
    for _ in range(2):
        np.testing.assert_array_equal(_traced(tracer, view)[0], expected)


def test_what_lies_together_goes_together() -> None:
    """Shuffled triangles look at boxes one by one, the same ones in order sixteen at a time; entries are the same,
    tiles that are finished earlier or later aside."""
    view, expected = _view("sheets")
    tracer = ShadowTracer("light_grid", "packed", "cpu", _bounds(), threads=1)
    states, together = _traced(tracer, view)
    np.testing.assert_array_equal(states, expected)
    order = np.random.default_rng(482).permutation(len(view.triangles))
    states, alone = _traced(tracer, view, order)
    np.testing.assert_array_equal(states, expected)
    assert together["nodes_visited"] < 0.7 * alone["nodes_visited"], (together, alone)
    assert 0.5 < together["entries"] / alone["entries"] < 2.0
    assert together["overflow_passes"] == alone["overflow_passes"] == 0
    assert probe.wide("cpu")
