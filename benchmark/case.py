# SPDX-License-Identifier: Apache-2.0
"""A case: frames with a new mesh and a new depth image each, some lights, and the right answers for all of them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from procedural import Light
from scenes import Shot, View

from shadow_tracer import Bounds, DepthCamera, DirectionalLight, Scene, ShadowTracer, State

SUBSET = 1500  # samples that brute_force decides, too: of the first frame so many, of each other one a fifth
_NOISE = 2e-6  # of the depth, per frame: every image is a new one, and no picture changes


class Wrong(SystemExit):
    """Raised on a wrong mask of ours."""


@dataclass(frozen=True)
class LightRays:
    """The N shadow rays of a light: (N, 3) float32 starts after the bias, (N, 3) unit ways, (N,) lengths."""

    starts: np.ndarray
    ways: np.ndarray
    reach: np.ndarray

    def of(self, chosen: np.ndarray) -> LightRays:
        """Some of them, in the order of ``chosen``."""
        return LightRays(self.starts[chosen], self.ways[chosen], self.reach[chosen])


class FrameRays:
    """The rays of a depth image, made before any clock starts.

    Attributes:
        shot: depth image and camera.
        valid: (H W,) bool, the pixels with a depth.
        points: (N, 3) float64 samples of these pixels.
        lights: rays per light.
    """

    def __init__(self, shot: Shot, lights: Sequence[Light], bias: float) -> None:
        self.shot = shot
        depth = shot.depth
        metres = depth / 1000.0 if depth.dtype == np.uint16 else depth.astype(np.float64)
        self.valid = (np.isfinite(metres) & (metres > 0.0)).ravel()
        self.points = shot.camera.unproject(metres).reshape(-1, 3)[self.valid]
        self.lights = [_rays(self.points, light, bias) for light in lights]

    def of(self, chosen: np.ndarray) -> FrameRays:
        """Some of the samples, in the order of ``chosen``; the image is as it was."""
        some = copy.copy(self)
        some.points = self.points[chosen]
        some.lights = [rays.of(chosen) for rays in self.lights]
        return some


def _rays(points: np.ndarray, light: Light, bias: float) -> LightRays:
    if isinstance(light, DirectionalLight):
        way = np.tile(-light.direction / np.linalg.norm(light.direction), (len(points), 1))
        distance = np.full((len(points), 1), 1e30)
    else:
        way = light.position - points
        distance = np.linalg.norm(way, axis=1, keepdims=True)
        way /= distance
    starts = (points + bias * way).astype(np.float32)
    return LightRays(starts, way.astype(np.float32), (distance[:, 0] - bias).astype(np.float32))


def shots(view: View, count: int) -> list[Shot]:
    """``count`` depth images of a view, no two alike: recorded ones, or a rendered one with a noise of 1e-6."""
    if view.recorded:
        return [view.recorded[k % len(view.recorded)] for k in range(count)]
    camera = view.camera
    bounds = Bounds(max_triangles=len(view.triangles), max_rays=camera.width * camera.height)
    scene = Scene(bounds)
    scene.put("mesh", view.positions[0], view.triangles)
    depth, _ = DepthCamera("cpu", bounds).render(scene, camera)
    if view.pixels is not None:
        depth[~view.pixels] = np.nan
    return [Shot(depth * np.float32(1.0 + k * _NOISE), camera) for k in range(count)]


class Case:
    """What all methods are measured on.

    Attributes:
        view: mesh, light, bias.
        lights: at least one.
        frames: rays per frame; frame k has ``view.positions[k]`` as mesh when the mesh moves.
        dynamic, static: per frame the (L, N) answers, the mesh moving or as in frame 0.

    Raises:
        Wrong: mesh_bvh and brute_force disagree on a sample of the random subset that both decide.
    """

    def __init__(self, view: View, frames: int, lights: Sequence[Light] | None = None) -> None:
        self.view = view
        self.lights = list(lights or [view.light])
        count = min(frames, len(view.positions))
        self.frames = [FrameRays(shot, self.lights, view.bias) for shot in shots(view, count)]
        self._judge = ShadowTracer("mesh_bvh", device="cpu", bounds=self.bounds())
        self._oracle = ShadowTracer("brute_force", device="cpu", bounds=self.bounds(SUBSET))
        for tracer in (self._judge, self._oracle):
            tracer.scene.put("mesh", view.positions[0], view.triangles)
        self.static = [self._answer(k, 0) for k in range(count)]
        self.dynamic = [self.static[0], *(self._answer(k, k) for k in range(1, count))]
        del self._judge, self._oracle

    def bounds(self, rays: int | None = None) -> Bounds:
        """Bounds that fit: all triangles, and the pixels of an image or ``rays``."""
        pixels = max(frame.valid.size for frame in self.frames)
        return Bounds(
            max_triangles=len(self.view.triangles), max_rays=rays or pixels, max_lights=max(len(self.lights), 1)
        )

    def drawn(self, count: int) -> Case:
        """The case of ``count`` samples of each frame, or all, in random order: for ``occluded``, not for images."""
        some = copy.copy(self)
        chosen = [
            np.random.default_rng(k).permutation(len(frame.points))[:count] for k, frame in enumerate(self.frames)
        ]
        some.frames = [frame.of(order) for frame, order in zip(self.frames, chosen, strict=True)]
        some.static = [answers[:, order] for answers, order in zip(self.static, chosen, strict=True)]
        some.dynamic = [answers[:, order] for answers, order in zip(self.dynamic, chosen, strict=True)]
        return some

    @property
    def rays(self) -> int:
        """Shadow rays of the first frame, all lights together."""
        return len(self.frames[0].points) * len(self.lights)

    @property
    def in_shadow(self) -> float:
        """Part of the rays of the first frame that are occluded."""
        return float(self.dynamic[0].mean()) if self.dynamic[0].size else 0.0

    def _answer(self, frame: int, mesh: int) -> np.ndarray:
        rays, view = self.frames[frame], self.view
        for tracer in (self._judge, self._oracle):
            tracer.scene.deform("mesh", view.positions[mesh])
        found = self._judge.trace(rays.shot.depth, rays.shot.camera, self.lights, bias=view.bias)
        answer = hidden(found, self.lights, rays)
        generator = np.random.default_rng(frame)
        for number, light in enumerate(self.lights):
            wished = SUBSET if frame == 0 else SUBSET // 5
            count = min(max(wished // len(self.lights), 50), len(rays.points))
            chosen = generator.choice(len(rays.points), count, replace=False)
            expected = self._oracle.occluded(rays.points[chosen], light, bias=view.bias)
            wrong = int((answer[number, chosen] != expected).sum())
            if wrong:
                raise Wrong(f"{view.name}: mesh_bvh differs from brute_force in {wrong} samples of frame {frame}")
        return answer


def hidden(frame, lights: Sequence[Light], rays: FrameRays) -> np.ndarray:
    """(L, N) bool: which rays of a traced frame are occluded."""
    states = [frame.state(light.name).ravel()[rays.valid] == State.SHADOWED for light in lights]
    return np.stack(states)
