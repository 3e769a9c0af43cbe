# SPDX-License-Identifier: Apache-2.0
"""By how much depths are too small, as they are computed: against fractions, and never more than the slack."""

from __future__ import annotations

from typing import Any

import closest_hit
import geometry
import numpy as np
import probe
import pytest
from one_world import OneWorld

from shadow_tracer import Bounds, Camera, Scene

pytestmark = probe.in_both_forms

_BOUNDS = Bounds(max_triangles=10, max_rays=2000, grid_entries=1000)


def _plane_depth(camera: Camera, corners: np.ndarray, way: np.ndarray) -> float:
    """The depth of a hit as it is computed (``depth_plane.h``)."""
    a, b, c = sorted(corners.tolist())
    e, f = [y - x for x, y in zip(a, b, strict=True)], [y - x for x, y in zip(a, c, strict=True)]
    n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]]
    row = np.linalg.inv(camera.camera_to_world[:3, :3])[2].tolist()
    eye = camera.position.tolist()

    def along(x: list[float], y: list[float]) -> float:
        return (x[0] * y[0] + x[1] * y[1]) + x[2] * y[2]

    away = [[x - o for x, o in zip(corner, eye, strict=True)] for corner in (a, b, c)]
    depths = [along(row, each) for each in away]
    size = along(n, way.tolist())
    with np.errstate(all="ignore"):
        t = float(np.abs(np.float64(along(n, away[0])) / np.float64(size)))
    low, high = max(min(depths), 0.0), max(depths)
    t = t if t > low else low
    return t if t < high else high


def _edge_on(rng: np.random.Generator) -> tuple[np.ndarray, Camera]:
    """Eye and triangle in one plane but for a few roundings, or somewhat more."""
    turn, eye = geometry.rotation(rng), rng.normal(size=3) * 10.0 ** rng.integers(-3, 4)
    flat = np.array([(-2.0, 3.0), (2.0, 3.5), (0.3, 7.0)])
    above = 2.0 ** -rng.integers(20, 60)
    corners = eye + flat[:, :1] * turn[:, 0] + above * turn[:, 1] + flat[:, 1:] * turn[:, 2]
    return corners, Camera(25, 3, 20.0, 20.0, 12.0, 1.0, geometry.pose_of(turn, eye))


def _sliver(rng: np.random.Generator) -> tuple[np.ndarray, Camera]:
    """Two corners close to each other, or all three almost in a line that many rays cross or run along."""
    turn, eye = geometry.rotation(rng), rng.normal(size=3)
    flat = np.array([(-3.0, 0.0, 3.0), (3.0, 0.0, 8.0), (0.0, 2.0 ** -rng.integers(3, 56), 5.5)])
    return eye + flat @ turn.T, Camera(25, 3, 20.0, 20.0, 12.0, 1.0, geometry.pose_of(turn, eye))


@pytest.mark.parametrize("kind", [_edge_on, _sliver])
def test_depths_are_too_small_by_no_more_than_the_slack(any_device: str, kind: Any) -> None:
    world, hits, most = OneWorld(any_device, _BOUNDS, ("brute_force",)), 0, 0.0
    for seed in range(60):
        corners, camera = kind(np.random.default_rng(seed))
        scene, triangles = Scene(_BOUNDS), np.array([(0, 1, 2)])
        scene.put("one", corners, triangles)
        seen = world.check(scene, camera).reshape(3, 25)
        depth = world.render(scene, camera)[0].reshape(3, 25)
        world.walk("brute_force", camera)
        ways, slack = closest_hit.directions(camera), world.hits.slack()
        for row, column in np.argwhere(seen == 0):
            computed = _plane_depth(camera, corners, ways[row, column])
            assert np.float32(computed) == depth[row, column]
            exact = closest_hit.exact_hits(camera, row, column, corners, triangles)[0]
            short = float(exact - closest_hit.Fraction(computed))
            assert short <= slack
            hits, most = hits + 1, max(most, short / slack)
    assert hits > 50
    if kind is _edge_on:
        assert most > 0.1, "the slack is not many times what it takes"


def test_what_is_seen_well_has_next_to_no_slack(any_device: str) -> None:
    world, scene = OneWorld(any_device, _BOUNDS, ("brute_force",)), Scene(_BOUNDS)
    scene.put("wall", *geometry.square(2, 4.0, 1.0))
    world.check(scene, Camera(8, 6, 8.0, 8.0, 3.5, 2.5))
    assert 0.0 < world.hits.slack() < 1e-11
    flat = np.array([(0, 0, 3), (1, 1, 3), (2, 2, 3.0), (np.nan, 0, 3), (0, 5, 9), (0, -5, 9)])
    scene.put("wall", flat, np.array([(0, 1, 2), (3, 1, 2)]), nonfinite="skip")  # no area, and no triangle
    world.check(scene, Camera(8, 6, 8.0, 8.0, 3.5, 2.5))
    assert world.hits.slack() == 0.0
