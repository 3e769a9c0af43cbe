# SPDX-License-Identifier: Apache-2.0
"""What the candidates of pipeline ``auto`` take on this device: frames of a known scene, a part of a second."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from shadow_tracer.gpu.engine.automatic import Chooser
from shadow_tracer.gpu.engine.costs import BRUTE_FORCE, Situation
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.lights import Light, PointLight
from shadow_tracer.scene.mesh import Scene

_SIZE = 192  # pixels a side
_CELLS, _FEW_CELLS = 70, 10  # a side of the sheet, of two triangles each; brute_force tests them all
_FRAMES = 3
_POSITIONS = 1


class Tracing(Protocol):
    """What this needs of the engine."""

    def trace_depth(self, scene: Scene, depth: np.ndarray, camera: Camera, lights: Sequence[Light], bias: Bias) -> Any:
        """Trace a frame."""


def calibrate(engine: Tracing, chooser: Chooser, bounds: Bounds) -> None:
    """Trace a sheet that waves between a camera and a wall with each candidate, and tell the chooser how long that
    took. Bounds that are too small for it leave the chooser with its rough law."""
    camera = Camera(_SIZE, _SIZE, _SIZE, _SIZE, _SIZE / 2, _SIZE / 2)
    depth = np.full((_SIZE, _SIZE), 3.0, np.float32)
    lights = [PointLight("lamp", (0.3, -0.2, 0.1))]
    try:
        for names in chooser.candidates:
            vertices, triangles = _sheet(_FEW_CELLS if names == BRUTE_FORCE else _CELLS)
            if depth.size > bounds.max_rays or len(triangles) > bounds.max_triangles:
                continue
            scene = Scene(bounds)
            scene.put("sheet", vertices, triangles)
            chooser.forced = names
            times = []
            for frame in range(_FRAMES + 1):
                begin = time.perf_counter()
                engine.trace_depth(scene, depth, camera, lights, Bias(0.01))
                times.append((time.perf_counter() - begin) * 1e3)
                scene.deform("sheet", vertices + 0.001 * frame)
            situation = Situation(_POSITIONS, depth.size, len(triangles), 1, True)
            chooser.calibrated(names, situation, min(times[1:]))
    finally:
        chooser.forced = None


def _sheet(cells: int) -> tuple[np.ndarray, np.ndarray]:
    across = np.linspace(-0.8, 0.8, cells + 1)
    u, v = np.meshgrid(across, across)
    vertices = np.stack([u, v, 1.5 + 0.1 * np.sin(5.0 * u) * np.cos(4.0 * v)], axis=-1).reshape(-1, 3)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    down = corner + cells + 1
    halves = (np.stack([corner, corner + 1, down + 1], axis=1), np.stack([corner, down + 1, down], axis=1))
    return vertices, np.concatenate(halves)
