# SPDX-License-Identifier: Apache-2.0
"""Normals of depth images: those of planes, none where the surface is cut, and the samples moved along them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import Bias, Camera
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.scene.normals import depth_normals, displaced_samples, focal_lengths, neighbours

_CAMERA = Camera(96, 72, 315.0, 300.0, 46.0, 36.5)  # neighbours are 3 pixels away


def _plane(camera: Camera, normal: np.ndarray, distance: float) -> np.ndarray:
    """(H, W) float32 depth of the plane whose points p have normal . p = distance, in the optical frame."""
    return (distance / (camera.pixel_rays() @ normal)).astype(np.float32)


def test_neighbours_are_a_hundredth_of_the_distance_away() -> None:
    """And at least one pixel; absurd focal lengths make no absurd numbers of pixels."""
    assert [neighbours(f)[0] for f in (1e-280, 20.0, 525.0, 550.0, 1000.0, 1e300)] == [1, 1, 5, 6, 10, 32767]
    assert neighbours(525.0)[1] == np.float32(5 / 525) and neighbours(1e-280)[1] == np.inf


@pytest.mark.parametrize("millimetres", [False, True])
@pytest.mark.parametrize("normal", [(0, 0, 1), (0.7, 0, 1), (0, -1.5, 1), (-0.5, 0.8, 1)])
def test_of_planes(normal: tuple[float, float, float], millimetres: bool) -> None:
    """Everywhere, to the border of the image, on the side of the camera, in the world."""
    rng = np.random.default_rng(41)
    camera = replace(_CAMERA, camera_to_world=geometry.pose_of(geometry.rotation(rng), (3.0, -2.0, 9.0)))
    n = np.array(normal, float)
    depth = _plane(camera, n, 9.0)
    if millimetres:
        depth = np.round(1000.0 * depth).astype(np.uint16)
    found = depth_normals(depth, camera)
    expected = -(camera.camera_to_world[:3, :3] @ n) / np.linalg.norm(n)
    assert found.shape == (72, 96, 3)
    assert np.linalg.norm(found - expected, axis=-1).max() < (0.05 if millimetres else 1e-3)
    way = camera.position - camera.unproject(depth / (1000.0 if millimetres else 1.0))
    assert (np.einsum("ijk,ijk->ij", found, way) > 0.0).all()


def test_with_a_table_of_rays() -> None:
    """Of a fisheye lens; a pixel without a ray has no normal, and its neighbours do without it. What the camera says of
    its focal length says nothing then."""
    lens = Camera.distorted(96, 72, 60.0, 60.0, 46.0, 36.5, "equidistant", (0.05, 0.0, 0.0, 0.0))
    assert lens.rays is not None
    rays = lens.rays.xy.copy()
    rays[30, 50] = np.nan
    camera = Camera(96, 72, 1.0, 1e9, 0.0, 0.0, rays=rays)
    n = np.array([0.2, -0.3, 1.0])
    found = depth_normals(_plane(camera, n, 3.0), camera)
    assert np.isnan(found[30, 50]).all()
    found[30, 50] = -n / np.linalg.norm(n)
    away = np.linalg.norm(camera.pixel_rays()[..., :2], axis=-1)
    near = away < 1.2  # farther out a neighbour is another depth than a twentieth
    assert np.linalg.norm(found + n / np.linalg.norm(n), axis=-1)[near | np.isnan(away)].max() < 1e-3
    one = Camera(1, 1, 1.0, 1.0, 0.0, 0.0, rays=np.full((1, 1, 2), np.nan))
    assert focal_lengths(one) == (1.0, 1.0) and np.isnan(depth_normals(np.ones((1, 1), np.float32), one)).all()
    assert focal_lengths(camera) == pytest.approx((60.0, 60.0), rel=0.3)


def test_noise_turns_them_by_little() -> None:
    """3 mm at 2 m, neighbours 2 cm apart."""
    depth = _plane(_CAMERA, np.array([0.5, 0.0, 1.0]), 2.0)
    depth += np.random.default_rng(42).normal(0.0, 0.003, depth.shape).astype(np.float32)
    expected = -np.array([0.5, 0.0, 1.0]) / np.sqrt(1.25)
    assert np.median(depth_normals(depth, _CAMERA) @ expected) > np.cos(np.radians(8.0))


def test_surfaces_on_either_side_of_a_step_do_not_mix() -> None:
    depth = np.full((72, 96), 2.0, np.float32)
    depth[:, 40:] = 2.2
    found = depth_normals(depth, _CAMERA)
    np.testing.assert_allclose(found, np.broadcast_to((0.0, 0.0, -1.0), found.shape), atol=1e-12)
    depth[:, 40:] = 2.05  # no step yet
    assert np.isfinite(found).all() and (np.abs(depth_normals(depth, _CAMERA)[:, 37:43, 0]) > 0.1).all()


def test_there_is_none_where_neighbours_lie_on_a_line() -> None:
    """A pole of three pixels across, a diagonal, a row, a column, a pixel; and what is invalid."""
    depth = np.full((72, 96), 2.0, np.float32)
    depth[:, 41:44] = 1.0
    has = np.isfinite(depth_normals(depth, _CAMERA)).all(axis=-1)
    assert not has[:, 41:44].any() and has[:, :41].all() and has[:, 44:].all()
    diagonal = np.where(np.subtract.outer(np.arange(72), np.arange(96)) == 0, 2.0, np.nan).astype(np.float32)
    assert np.isnan(depth_normals(diagonal, _CAMERA)).all()
    for shape in ((1, 96), (72, 1), (1, 1)):
        camera = replace(_CAMERA, height=shape[0], width=shape[1])
        assert np.isnan(depth_normals(np.full(shape, 2.0, np.float32), camera)).all()
    for invalid in (0.0, -1.0, np.nan, np.inf, 1e-38, 3e38):
        depth = np.full((72, 96), 2.0, np.float32)
        depth[30:33, 50] = invalid
        has = np.isfinite(depth_normals(depth, _CAMERA)).all(axis=-1)
        np.testing.assert_array_equal(has, depth == 2.0)
    masked = np.ma.masked_array(np.full((72, 96), 2000, np.uint16), np.indices((72, 96))[1] == 7)
    np.testing.assert_array_equal(np.isnan(depth_normals(masked, _CAMERA))[0, :, 0], np.arange(96) == 7)


def test_samples_are_moved_by_the_bias() -> None:
    depth = _plane(_CAMERA, np.array([0.5, 0.0, 1.0]), 2.0)
    depth[10, 20] = np.nan
    depth[:, 40:42] = 1.0
    points, has = _CAMERA.unproject(depth), np.isfinite(depth_normals(depth, _CAMERA)).all(axis=-1)
    assert 0.9 < has.mean() < 1.0
    moved = displaced_samples(depth, _CAMERA, Bias(0.02, 0.003, normal=0.5))
    length = 0.5 * (0.02 + 0.003 * depth.astype(float) ** 2)
    np.testing.assert_allclose(np.linalg.norm(moved - points, axis=-1)[has], length[has], rtol=1e-9)
    np.testing.assert_array_equal(moved[~has], points[~has])
    np.testing.assert_array_equal(displaced_samples(depth, _CAMERA, Bias(0.02, 0.003)), points)
    # As far as coordinates go, and no farther.
    there = replace(_CAMERA, camera_to_world=geometry.pose_of(np.eye(3), (0.0, 0.0, -0.5 * LARGEST)))
    far = displaced_samples(depth, there, Bias(LARGEST, normal=LARGEST))
    np.testing.assert_array_equal(far, there.unproject(depth))


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.ones((72, 96)), "depth: expected dtype float32 .metres. or uint16 .millimetres., got float64"),
        (np.ones((96, 72), np.float32), r"depth: expected shape \(72, 96\) as the camera has, got \(96, 72\)"),
    ],
)
def test_images_that_are_refused(depth: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        depth_normals(depth, _CAMERA)
