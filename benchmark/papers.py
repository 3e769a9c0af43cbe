# SPDX-License-Identifier: Apache-2.0
"""What the programs that repeat the papers' experiments share: scenes, and times of frames whose masks were compared.

Times are processor time of the whole process (user and system, all of its threads) for ``scene.deform`` and
``ShadowTracer.trace`` of one frame, numpy to numpy; on CUDA they are wall time. The least of a few frames is given:
what is compared are variants, and a busy machine only ever adds. No time is given for a mask that is not that of
``mesh_bvh`` in every pixel.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import procedural
from PIL import Image
from scenes import data_folder

from shadow_tracer import Bounds, Camera, DepthCamera, Scene, ShadowTracer, State

_BUDGET = 2.5  # seconds of frames for one figure; a frame that alone takes longer is measured once


@dataclass(frozen=True)
class Still:
    """A frame to trace: a mesh, a depth image of it, and a light.

    Attributes:
        name: what it is called in tables.
        vertices: (V, 3) float64.
        triangles: (T, 3) int32.
        camera: where the depth image is taken from.
        depth: (H, W) float32 along the optical axis, NaN where there is nothing.
        light: any light.
        bias: in the units of the mesh.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    camera: Camera
    depth: np.ndarray
    light: procedural.Light
    bias: float


@dataclass(frozen=True)
class Measured:
    """Least milliseconds of some frames, how many they were, counters and milliseconds per stage of the last one."""

    milliseconds: float
    frames: int
    counters: dict[str, int]
    stages: dict[str, float]

    def share(self, stage: str) -> float:
        """Part of the frame that a stage takes."""
        return self.stages.get(stage, 0.0) / max(sum(self.stages.values()), 1e-9)


def load(name: str) -> dict[str, np.ndarray] | None:
    """Arrays of ``meshes/<name>.npz`` of the data folder; None, said aloud, where there is none."""
    folder = data_folder()
    path = folder / "meshes" / f"{name}.npz" if folder else None
    if path is None or not path.is_file():
        print(f"skipped without the data folder (set SHADOW_TRACER_DATA): {name}")
        return None
    with np.load(path) as archive:
        return {key: archive[key] for key in archive.files}


def photograph(
    vertices: np.ndarray, triangles: np.ndarray, camera: Camera, pixels: np.ndarray | None = None
) -> np.ndarray:
    """(H, W) float32 depth that the camera sees of a mesh, NaN where there is nothing or ``pixels`` is False."""
    scene = Scene()
    scene.put("mesh", vertices, triangles)
    bounds = Bounds(max_triangles=len(triangles), max_rays=camera.width * camera.height)
    depth, _ = DepthCamera("cpu", bounds).render(scene, camera)
    if pixels is not None:
        depth[~pixels] = np.nan
    return depth


class Bench:
    """Traces frames by one pipeline after the other, and by ``mesh_bvh``, with which every mask is compared.

    Args:
        stills: what will be traced; the first says how many triangles and pixels there may be.
        device: of both.
        culling: whether triangles that face the light cast nothing, for both.
    """

    def __init__(self, stills: list[Still], device: str, culling: bool) -> None:
        most, rays = max(len(still.triangles) for still in stills), max(still.depth.size for still in stills)
        bounds = Bounds(max_triangles=most, max_rays=rays, max_lights=1)
        self.tracer = ShadowTracer("mesh_bvh", device=device, bounds=bounds, front_face_culling=culling)
        self._oracle = ShadowTracer("mesh_bvh", device=device, bounds=bounds, front_face_culling=culling)
        self._masks: dict[str, np.ndarray] = {}

    def mask(self, still: Still) -> np.ndarray:
        """(H, W) states by ``mesh_bvh``, of each still made once."""
        if still.name not in self._masks:
            self._oracle.scene.put("mesh", still.vertices, still.triangles)
            frame = self._oracle.trace(still.depth, still.camera, [still.light], bias=still.bias)
            self._masks[still.name] = frame.state(still.light.name).copy()
        return self._masks[still.name]

    def measure(self, still: Still, frames: int) -> Measured:
        """Frames of a still by the pipeline that ``tracer`` has selected, as many as ``frames`` or as fit the budget.

        Raises:
            SystemExit: a mask differs from that of ``mesh_bvh``.
        """
        expected = self.mask(still)
        self.tracer.scene.put("mesh", still.vertices, still.triangles)
        clock: Callable[[], float] = time.process_time if self.tracer.device == "cpu" else time.perf_counter
        times: list[float] = []
        for _ in range(frames + 1):
            begin = clock()
            self.tracer.scene.deform("mesh", still.vertices)
            frame = self.tracer.trace(still.depth, still.camera, [still.light], bias=still.bias)
            times.append(clock() - begin)
            wrong = int((frame.state(still.light.name) != expected).sum())
            if wrong:
                way = f"{self.tracer.pipeline}/{self.tracer.variant}"
                raise SystemExit(f"{still.name}: {way} differs from mesh_bvh in {wrong} pixels")
            if sum(times) > _BUDGET:
                break
        kept = times[1:] or times
        return Measured(1e3 * min(kept), len(kept), frame.counters, frame.stages)


def hidden(states: np.ndarray) -> float:
    """Part of the pixels with a depth that is in shadow."""
    known = states != State.INVALID
    return float((states[known] == State.SHADOWED).mean()) if known.any() else 0.0


def plotting() -> Any:
    """Matplotlib's pyplot, without a window."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def axes_style(axes: Any, title: str, x: str, y: str) -> None:
    """Title and labels of a diagram, the same for all."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(True, which="major", alpha=0.35)


def readable(axes: Any) -> None:
    """Plain numbers at 1, 2 and 5 of each decade of a logarithmic axis."""
    from matplotlib import ticker

    axes.yaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())


def save(figure: Any, path: Path) -> None:
    """Write a diagram, in few colours: small enough for a repository."""
    figure.savefig(path, dpi=100)
    with Image.open(path) as image:
        image.convert("RGB").quantize(160, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size // 1000} kB")
