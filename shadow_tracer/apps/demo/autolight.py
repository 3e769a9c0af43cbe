# SPDX-License-Identifier: Apache-2.0
"""Finds lights that make shadows worth looking at in a place known only by a mesh and some depth frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo import render
from shadow_tracer.apps.demo.lighting import Geometry, StageLight
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.lights import DirectionalLight, PointLight, SpotLight

Floats = NDArray[np.float64]
SPOT_HALF_ANGLE = 0.45


def down_of(cameras: Sequence[Camera]) -> tuple[float, float, float]:
    """Unit vector to the ground, guessed from how the cameras were held; an axis of the world if one is near."""
    mean = np.mean([camera.camera_to_world[:3, 1] for camera in cameras], axis=0)
    mean /= np.linalg.norm(mean)
    axis = int(np.argmax(np.abs(mean)))
    if abs(mean[axis]) > 0.85:
        mean = np.sign(mean[axis]) * np.eye(3)[axis]
    return float(mean[0]), float(mean[1]), float(mean[2])


class Place:
    """A recorded place, measured.

    Args:
        vertices: (V, 3) metres.
        triangles: (T, 3) indices.
        frames: cameras with their depth images, (H, W) uint16 millimetres.
        down: unit vector to the ground.

    Attributes:
        bias: metres by which shadow rays must start off the surface so that measured points behind the mesh stay lit.
    """

    def __init__(
        self,
        vertices: Floats,
        triangles: NDArray[np.int32],
        frames: Sequence[tuple[Camera, NDArray[np.uint16]]],
        down: tuple[float, float, float],
    ) -> None:
        self._mesh = render.RayCaster(vertices, triangles)
        self._frames = frames
        self._down = np.asarray(down)
        self._points, self._normals, self.bias = self._measure(vertices[triangles])
        self._centre = np.median(self._points, axis=0)
        self._size = float(np.linalg.norm(np.subtract(*np.percentile(self._points, [90, 10], axis=0))))
        first = frames[0][0]
        self._right = np.asarray(first.camera_to_world[:3, 0])
        self._eye = np.asarray(first.position)

    def lights(self) -> tuple[StageLight, ...]:
        """A lamp, a spotlight and the sun, each the best of its candidates."""
        lamp = self._best(PointLight("lamp", at) for at in self._free(self._around()))
        spot = self._best(
            SpotLight("spotlight", at, self._centre - at, SPOT_HALF_ANGLE) for at in self._free(self._beside())
        )
        sun = self._best(DirectionalLight("sun", way) for way in self._ways())
        distance = float(np.median(np.linalg.norm(self._points - lamp.homogeneous[:3], axis=1)))
        throw = float(np.linalg.norm(self._centre - spot.homogeneous[:3]))
        return (
            StageLight(lamp, (1.0, 0.72, 0.42), 0.95 * (distance**2 + 0.15)),
            StageLight(spot, (0.45, 0.74, 1.0), 1.1 * (throw**2 + 0.15)),
            StageLight(sun, (1.0, 0.92, 0.78), 1.0),
        )

    def _around(self) -> list[Floats]:
        """Places for a lamp: between the first camera and the middle of the scene, to the sides and above."""
        up = -self._down
        return [
            self._eye + s * (self._centre - self._eye) + self._size * (a * self._right + h * up)
            for s in (0.35, 0.55, 0.75)
            for a in (-0.35, -0.2, 0.2, 0.35)
            for h in (0.0, 0.1, 0.2)
        ]

    def _beside(self) -> list[Floats]:
        """Places for a spotlight: beside and above the first camera."""
        up = -self._down
        return [
            self._eye + self._size * (a * self._right + h * up) + 0.1 * (self._centre - self._eye)
            for a in (-0.45, -0.3, -0.18, 0.18, 0.3, 0.45)
            for h in (0.0, 0.12, 0.25)
        ]

    def _ways(self) -> list[Floats]:
        """Ways for sunlight, from high and from half high all round."""
        ahead = np.cross(self._right, self._down)
        across = np.cross(self._down, ahead)
        turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        return [
            np.sin(height) * self._down + np.cos(height) * (np.cos(a) * ahead + np.sin(a) * across)
            for height in (0.6, 0.8, 1.0)
            for a in turns
        ]

    def _free(self, candidates: list[Floats]) -> list[Floats]:
        """Those candidates that no frame sees a surface in front of; all of them if that leaves none."""
        kept = [at for at in candidates if not any(_behind(at, camera, depth) for camera, depth in self._frames)]
        return kept or candidates

    def _best(self, candidates: Iterable[Geometry]) -> Geometry:
        return min(candidates, key=self._fault)

    def _fault(self, light: Geometry) -> float:
        """How far the light is from showing well: two thirds of its field lit, and little of it at a grazing angle."""
        way = light.homogeneous[:3] - self._points * light.homogeneous[3]
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        axis, cosine = light.cone
        inside = -(way @ axis) >= cosine
        if inside.mean() < 0.15:
            return 2.0
        lit = ~self._mesh.hidden(self._points[inside], light, self.bias)
        grazing = np.abs(np.einsum("ni,ni->n", way, self._normals)[inside]) < 0.25
        return abs(float(lit.mean()) - 0.66) + float(grazing.mean())

    def _measure(self, corners: Floats) -> tuple[Floats, Floats, float]:
        """Points of every 16th pixel with normals of the mesh there, and the bias.

        The bias is 2.5 times the 90th percentile of the distance between measured depth and mesh, 0.01 to 0.15 m.
        """
        points, normals, errors = [], [], []
        for camera, depth in self._frames:
            model, ids = self._mesh.image(camera)
            use = (depth > 0) & (ids >= 0)
            errors.append(np.abs(model[use] - depth[use] / 1000))
            some = use[::16, ::16]
            points.append(camera.unproject(depth / 1000)[::16, ::16][some])
            a, b, c = np.moveaxis(corners[ids[::16, ::16][some]], 1, 0)
            normals.append(np.cross(b - a, c - a))
        normal = np.concatenate(normals)
        if len(normal) < 10:
            raise ValueError("mesh: the frames see next to nothing of it; is it in metres, in the frame of the poses?")
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        bias = float(np.clip(2.5 * np.percentile(np.concatenate(errors), 90), 0.01, 0.15))
        return np.concatenate(points), normal, bias


def _behind(point: Floats, camera: Camera, depth: NDArray[Any], margin: float = 0.1) -> bool:
    """Whether the camera sees a surface nearer than `point` in its direction (False if it looks elsewhere)."""
    x, y, z = camera.camera_to_world[:3, :3].T @ (point - camera.position)
    if z <= 0.05:
        return False
    u, v = round(camera.fx * x / z + camera.cx), round(camera.fy * y / z + camera.cy)
    if not (0 <= u < camera.width and 0 <= v < camera.height):
        return False
    return bool(0 < depth[v, u] < 1000 * (z + margin))
