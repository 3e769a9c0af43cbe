# SPDX-License-Identifier: Apache-2.0
"""A corner of a room under lights without and with a size: what ``Frame.visibility`` says, times the cosine at which
light meets the surface.

    python benchmark/pictures_soft_shadows.py

draws ``docs/images/soft_shadows.png``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from shadow_tracer import (
    Camera,
    PointLight,
    RectangleLight,
    Scene,
    ShadowTracer,
    SunDisc,
    TubeLight,
    render_depth,
)

_OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "soft_shadows.png"
_WIDTH, _HEIGHT = 480, 360
_LAMP = (0.1, -0.4, 2.2)
_LIGHTS: dict[str, Any] = {
    "PointLight": PointLight("lamp", _LAMP, ignore=["fixture"]),
    "RectangleLight": RectangleLight("lamp", _LAMP, (0.0, 0.3, 0.0), (0.3, 0.0, 0.0), ignore=["fixture"]),
    "TubeLight": TubeLight("lamp", (-0.5, -0.4, 2.2), (0.7, -0.4, 2.2), 0.013, ignore=["fixture"]),
    "SunDisc, 2 degrees": SunDisc("lamp", (0.35, 0.9, -1.1), np.radians(2.0)),
}


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return corners, np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))])


def _ball(centre: tuple[float, float, float], radius: float, steps: int = 48) -> tuple[np.ndarray, np.ndarray]:
    turn, rise = np.meshgrid(
        np.linspace(0.0, 2.0 * np.pi, 2 * steps, endpoint=False), np.linspace(0.0, np.pi, steps + 1)
    )
    points = np.stack([np.sin(rise) * np.cos(turn), np.sin(rise) * np.sin(turn), np.cos(rise)], axis=-1)
    row, column = np.mgrid[:steps, : 2 * steps].reshape(2, -1)
    beside = (column + 1) % (2 * steps)
    a, b, c, d = (r * 2 * steps + k for r, k in ((row, column), (row + 1, column), (row + 1, beside), (row, beside)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return radius * points.reshape(-1, 3) + centre, triangles


def _put(scene: Scene) -> None:
    scene.put("floor", *_box((-3.0, -3.0, -0.1), (3.0, 3.0, 0.0)))
    scene.put("wall", *_box((-3.0, 1.2, 0.0), (3.0, 1.3, 3.0)))
    scene.put("box", *_box((-0.9, -0.1, 0.0), (-0.4, 0.4, 0.7)))
    scene.put("ball", *_ball((0.55, 0.1, 0.35), 0.35))
    for k, (x, y) in enumerate(((-0.15, 0.5), (0.15, 0.5), (-0.15, 0.8), (0.15, 0.8))):
        scene.put(f"stool/{k}", *_box((x - 0.02, y - 0.02, 0.0), (x + 0.02, y + 0.02, 0.9)))
    scene.put("stool/seat", *_box((-0.2, 0.45, 0.9), (0.2, 0.85, 0.94)))
    scene.put("fixture", *_box((-0.6, -0.75, 2.19), (0.8, -0.05, 2.25)))


def _camera() -> Camera:
    eye, target = np.array((0.1, -3.1, 1.75)), np.array((0.0, 0.4, 0.5))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(forward, right), forward], axis=1), eye
    return Camera(_WIDTH, _HEIGHT, 470.0, 470.0, _WIDTH / 2 - 0.5, _HEIGHT / 2 - 0.5, pose)


def _cosines(scene: Scene, triangle: np.ndarray, points: np.ndarray, light: Any) -> np.ndarray:
    """(H, W) of the angle between the light's middle and the normal of what a pixel sees."""
    meshes = list(scene)
    corners = np.concatenate([mesh.vertices[mesh.triangles] for mesh in meshes])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]
    way = -light.direction if isinstance(light, SunDisc) else light.position - points
    way = way / np.linalg.norm(way, axis=-1, keepdims=True)
    return np.abs((normals[triangle] * way).sum(axis=-1))


def main() -> None:
    """Draw the picture."""
    tracer, camera = ShadowTracer("mesh_bvh"), _camera()
    _put(tracer.scene)
    depth, triangle = render_depth(tracer.scene, camera)
    points = camera.unproject(np.where(np.isfinite(depth), depth, 1.0))
    sheet = Image.new("L", (2 * _WIDTH, 2 * _HEIGHT))
    for number, (title, light) in enumerate(_LIGHTS.items()):
        seen = np.nan_to_num(tracer.trace(depth, camera, [light], 0.002).visibility("lamp"))
        lit = 0.09 + 0.8 * seen * _cosines(tracer.scene, triangle, points, light)
        shade = np.where(np.isfinite(depth), lit, 0.0) ** (1.0 / 2.2)
        picture = Image.fromarray((255.0 * np.clip(shade, 0.0, 1.0)).astype(np.uint8))
        ImageDraw.Draw(picture).text((8, 6), title, fill=255, font_size=18)
        sheet.paste(picture, (number % 2 * _WIDTH, number // 2 * _HEIGHT))
    sheet.save(_OUT, optimize=True)
    print(f"{_OUT}: {_OUT.stat().st_size} bytes")


if __name__ == "__main__":
    main()
