# SPDX-License-Identifier: Apache-2.0
"""Depth, colours and masks to shaded pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo.lighting import StageLight
from shadow_tracer.scene.camera import Camera

Picture = NDArray[np.uint8]
Image = NDArray[np.float32]
Vector = tuple[float, float, float]
SKYLIGHT = np.array([0.105, 0.125, 0.155], dtype=np.float32)
BOUNCE = np.array([0.090, 0.080, 0.068], dtype=np.float32)


class Surface:
    """What the camera sees, ready to be lit.

    Args:
        depth: (H, W) float32 metres, not finite or <= 0 where invalid.
        colour: (H, W, 3) uint8 sRGB albedo.
        camera: the camera with its pose.
        down: unit vector that points to the ground.
        smooth: how far [px] normals are averaged; 0 for noise-free depth, which also shows its full relief.
    """

    def __init__(self, depth: Image, colour: Picture, camera: Camera, down: Vector, smooth: int = 0) -> None:
        self.valid = np.isfinite(depth) & (depth > 0)
        filled = np.where(self.valid, depth, np.float32(0))
        self.points: Image = camera.unproject(filled).astype(np.float32)
        self.relief = 0.45 if smooth else 1.0
        self.albedo: Image = np.asarray((colour.astype(np.float32) / 255) ** 2.2, dtype=np.float32)
        view = self.points - camera.position.astype(np.float32)
        self.normals = _normals(self.points, view, filled, smooth)
        upward = (0.5 - 0.5 * (self.normals @ np.asarray(down, dtype=np.float32)))[..., None]
        around = SKYLIGHT * upward + BOUNCE * (1 - upward)
        self.ambient: Image = around * _openness(filled, self.valid, camera)[..., None]
        sky = np.where(self.valid, np.float32(0), np.float32(1))[..., None]
        self.sky: Image = self.albedo * sky

    def lit(self, lights: Sequence[StageLight], masks: Mapping[str, Picture], ambient: float = 1.0) -> Picture:
        """(H, W, 3) sRGB picture under `lights`, each only where its (H, W) mask is 255."""
        total = ambient * self.ambient
        for light in lights:
            total = (
                total + light.radiance(self.points, self.normals, self.relief) * (masks[light.name] == 255)[..., None]
            )
        if self.relief < 1:  # a photograph is lit already: more lights must not burn it out
            total = total * (2 / (1 + len(lights)))
        shaded = np.where(self.valid[..., None], self.albedo * total, min(1.0, 0.3 + 0.5 * ambient) * self.sky)
        return _tone(shaded)


def _tone(linear: Image) -> Picture:
    """Linear RGB to sRGB bytes along a filmic curve that keeps highlights."""
    x = 1.1 * linear
    curve = (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)
    return np.asarray(np.clip(curve, 0, 1) ** (1 / 2.2) * 255 + 0.5, dtype=np.uint8)


def _normals(points: Image, view: Image, depth: Image, smooth: int) -> Image:
    """(H, W, 3) unit normals towards the camera, from the neighbour on either side that is nearer in depth."""
    reach = max(1, smooth)
    steps = []
    for axis in (1, 0):
        before, after = (points - np.roll(points, k, axis=axis) for k in (reach, -reach))
        gap_before, gap_after = (np.abs(depth - np.roll(depth, k, axis=axis)) for k in (reach, -reach))
        steps.append(np.where((gap_before < gap_after)[..., None], before, -after))
    normal = np.cross(steps[0], steps[1])
    normal *= np.where(np.einsum("...i,...i->...", normal, view) > 0, -1, 1)[..., None]
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    if smooth > 0:
        normal = np.stack([_blur(normal[..., i], smooth) for i in range(3)], axis=-1)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return np.asarray(normal, dtype=np.float32)


def _openness(depth: Image, valid: NDArray[np.bool_], camera: Camera) -> Image:
    """How little each pixel is enclosed by nearer ones around it, 0.3..1 (ambient occlusion in the image)."""
    disparity = np.where(valid, 1 / np.maximum(depth, 1e-3), 0).astype(np.float32)
    closed = np.zeros_like(depth)
    for reach in (0.05, 0.15):
        radius = max(1, int(reach * camera.fx * float(np.median(disparity))))
        around = _blur(disparity, radius)
        closed += np.clip((around / np.maximum(disparity, 1e-6) - 1) * 2.0, 0, 1)
    return np.asarray(np.clip(1 - 0.5 * closed, 0.3, 1), dtype=np.float32)


def _blur(image: Image, radius: int) -> Image:
    """Two box blurs of the given half width, edges repeated."""
    for _ in range(2):
        for axis in (0, 1):
            pad = [(0, 0), (0, 0)]
            pad[axis] = (radius + 1, radius)
            total = np.cumsum(np.pad(image, pad, mode="edge"), axis=axis, dtype=np.float64)
            wide = 2 * radius + 1
            high, low = (total[wide:], total[:-wide]) if axis == 0 else (total[:, wide:], total[:, :-wide])
            image = ((high - low) / wide).astype(np.float32)
    return image
