# SPDX-License-Identifier: Apache-2.0
"""What the tests of depth images look at, and how they compare."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import closest_hit
import geometry
import numpy as np

from shadow_tracer import Bounds, Camera, Scene

_AZURE = (5.7, 3.6, 1e-4, -5e-5, 0.19, 6.0, 5.4, 1.0)
BOUNDS = Bounds(max_triangles=400_000, max_rays=70_000, grid_entries=600_000)


def generator(seed: int = 5) -> np.random.Generator:
    return np.random.default_rng(seed)


def look(width: int, height: int, eye: Any, target: Any, focal: float = 0.8, up: Any = (0, 0, 1)) -> Camera:
    pose = geometry.look_at(eye, target, up)
    return Camera(width, height, focal * width, focal * width, 0.5 * width - 0.3, 0.5 * height - 0.7, pose)


def _around(reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Huge triangles on all sides, through the image plane and behind."""
    return geometry.soup(generator(2), 60, reach, reach)


def _rounded(camera: Camera) -> Camera:
    """The same with a rotation of float32 numbers: orthonormal to 1e-7 only."""
    pose = camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3].astype(np.float32)
    return Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, pose)


def _views() -> dict[str, tuple[tuple[np.ndarray, np.ndarray], Camera]]:
    street, museum = geometry.street(generator()), geometry.museum(generator())
    ground = geometry.join([geometry.square(2, 0.0, 1000.0), geometry.icosphere(3, 1.0, (3, 0, 1))])
    across = look(65, 47, (9, 1, 2), (0, 0, 1.5))
    off = Camera(40, 30, 35.0, 50.0, -25.0, 61.5, across.camera_to_world)
    return {
        "street": (street, across),
        "street, rounded pose": (street, _rounded(across)),
        "street, principal point outside": (street, off),
        "museum, inside": (museum, look(80, 60, (4, 3, 0.4), (-1, 0, 0))),
        "small soup": (geometry.soup(generator(1), 2000, 0.02, 1.0), look(64, 64, (3, 0.1, 0.2), (0, 0, 0))),
        "around": (_around(30.0), look(50, 50, (0.1, 0.2, 0.3), (1, 0.5, 0.2), 0.3)),
        "around, wide angle": (_around(3.0), look(50, 50, (0.1, 0.2, 0.3), (1, 0.5, 0.2), 0.05)),
        "slivers": (geometry.slivers(generator(3), 900, 5.0, 60.0), look(90, 70, (0, 0, 0), (1, 0.3, 0.1))),
        "ground": (ground, look(64, 48, (-4, 0.3, 0.01), (3, 0, 0.5))),
        "telescope": (street, look(48, 48, (-3000, 200, 100), (0, 0, 1.5), 300.0)),
    }


def lens(kind: str, camera: Camera) -> Camera:
    """Another lens before a pinhole."""
    width, height, f, pose = camera.width, camera.height, camera.fx, camera.camera_to_world
    optics = width, height, f, f, width / 2, height / 2
    if kind == "rational":
        return Camera.distorted(*optics, "rational_polynomial", _AZURE, pose)
    if kind == "fisheye":  # its corners look to the side and behind
        return Camera.distorted(
            width, height, 0.25 * width, 0.25 * width, *optics[4:], "equidistant", (0, 0, 0, 0), pose
        )
    rng = generator(6)
    rays = rng.uniform(-1.0, 1.0, (height, width, 2)) * (6.0 if kind == "wild" else 0.3)
    if kind == "wild":  # in no order, some without, and some far outside of what the tiles of the grid are made for
        rays[rng.random(rays.shape[:2]) < 0.1] = np.nan
        rays[rng.random(rays.shape[:2]) < 0.1] *= 1e3
    return replace(camera, rays=rays)


VIEWS = _views()


def scene_of(mesh: tuple[np.ndarray, np.ndarray], **options: Any) -> Scene:
    scene = Scene(BOUNDS)
    scene.put("all", *mesh, **options)
    return scene


def same(forms: list[Any], scene: Scene, camera: Camera, depth: np.ndarray, triangle: np.ndarray) -> None:
    for form in forms:
        seen = form.render(scene, camera)
        assert np.array_equal(seen.triangle, triangle.ravel())
        assert seen.depth.tobytes() == depth.tobytes()


def check(camera: Camera, mesh: tuple[np.ndarray, np.ndarray], depth: np.ndarray, triangle: np.ndarray) -> None:
    """Against the float64 closest hit, borderline rays aside."""
    truth = closest_hit.closest(camera, *mesh)
    assert np.array_equal(triangle < 0, np.isnan(depth))
    assert truth.sure.mean() > 0.98, "hardly a ray may be borderline"
    seen = np.isfinite(truth.depth)
    assert np.array_equal((triangle >= 0)[truth.sure], seen[truth.sure])
    compared = truth.sure & seen
    error = np.abs(depth[compared] - truth.depth[compared]) / truth.depth[compared]
    assert error.size == 0 or error.max() <= 1e-6
    same = compared & truth.alone
    assert np.array_equal(triangle[same], truth.triangle[same])
