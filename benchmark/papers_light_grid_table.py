# SPDX-License-Identifier: Apache-2.0
"""Rows as in Table 1 of "Ray Tracing Dynamic Scenes with Shadows on GPU": for each model structure / tracing of primary
rays by others and by us, and a frame with shadows of one light.

The paper has HBVH, kd-tree and uniform grid of other authors; here these are Embree and ``wp.Mesh``, in the same run.
A depth image of ours is compared with its plain form's bit by bit, a peer's (float32) with ours: with more than 2 in
1000 pixels apart by 1e-4 the program stops. Processor time of the process, the quickest of a few frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
import warp as wp
from papers import Bench, Still, photograph
from report import table
from scenes import views

from shadow_tracer import Bounds, Scene
from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
from shadow_tracer.gpu.device.devices import pick_device

# The paper's Table 1: triangles in thousands, structure and tracing of primary rays, a frame with shadows [ms].
PAPER = {
    "Fairy": (174, 8.73, 32.43, 82.18),
    "Sibenik": (82, 8.86, 13.11, 58.81),
    "Bunny/Dragon": (252, 3.71, 10.92, 31.63),
    "Conference": (284, 7.51, 17.64, 61.15),
    "Cloth": (92, 5.23, 11.23, 44.47),
    "Buddha": (1090, 13.76, 38.91, 114.57),
}
_MOST_DIFFERENT = 2e-3


@wp.kernel(enable_backward=False)
def nearest_hit(mesh: wp.uint64, start: wp.vec3, ways: wp.array(dtype=wp.vec3), depth: wp.array(dtype=float)):
    i = wp.tid()
    found = wp.mesh_query_ray(mesh, start, ways[i], 1.0e30)
    depth[i] = wp.where(found.result, found.t, float(wp.nan))


def _least(steps: list[tuple[float, float]]) -> tuple[float, float]:
    """Structure and tracing of the quickest frame, the first one left out."""
    structure, tracing = min(steps[1:] or steps, key=sum)
    return 1e3 * float(structure), 1e3 * float(tracing)


def _check(still: Still, who: str, depth: np.ndarray) -> None:
    ours, theirs = still.depth.ravel(), depth.ravel()
    apart = np.isfinite(ours) != np.isfinite(theirs)
    both = ~apart & np.isfinite(ours)
    apart[both] = np.abs(theirs[both] - ours[both]) > 1e-4 * ours[both]
    if apart.sum() > _MOST_DIFFERENT * len(ours):
        raise SystemExit(f"{still.name}: {who} differs in {apart.sum()} of {len(ours)} pixels")


def _ways(still: Still) -> np.ndarray:
    ways: np.ndarray = (still.camera.pixel_rays() @ still.camera.camera_to_world[:3, :3].T).reshape(-1, 3)
    return ways.astype(np.float32)


def _repeat(
    still: Still, who: str, frames: int, build: Callable[[], Any], look: Callable[[Any], np.ndarray]
) -> tuple[float, float]:
    times = []
    for _ in range(frames + 1):
        begin = time.process_time()
        built = build()
        middle = time.process_time()
        depth = look(built)
        times.append((middle - begin, time.process_time() - middle))
        _check(still, who, depth)
    return _least(times)


def embree(still: Still, frames: int) -> tuple[float, float] | None:
    """Milliseconds of building and of closest hits; None without embreex."""
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError:
        return None
    ways, vertices = _ways(still), still.vertices.astype(np.float32)
    starts = np.tile(still.camera.position.astype(np.float32), (len(ways), 1))

    def build() -> Any:
        scene = rtcore_scene.EmbreeScene()
        TriangleMesh(scene, vertices, still.triangles)
        scene.run(starts[:1], ways[:1])  # the first query commits the scene
        return scene

    def look(scene: Any) -> np.ndarray:
        hits = scene.run(starts, ways, query="INTERSECT", output=1)
        return np.where(hits["primID"] >= 0, hits["tfar"], np.nan)

    return _repeat(still, "Embree", frames, build, look)


def warp_mesh(still: Still, frames: int) -> tuple[float, float]:
    """Milliseconds of building and of closest hits."""
    points = wp.array(still.vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
    indices = wp.array(still.triangles.ravel(), dtype=int, device="cpu")
    ways = wp.array(_ways(still), dtype=wp.vec3, device="cpu")
    depth = wp.empty(len(ways), dtype=float, device="cpu")
    start = wp.vec3(*still.camera.position.astype(np.float32))

    def look(mesh: wp.Mesh) -> np.ndarray:
        wp.launch(nearest_hit, dim=len(ways), inputs=[mesh.id, start, ways, depth], device="cpu")
        found: np.ndarray = depth.numpy()
        return found

    return _repeat(still, "wp.Mesh", frames, lambda: wp.Mesh(points, indices), look)


def primary(still: Still, frames: int) -> tuple[tuple[float, float], float]:
    """Milliseconds of everything before the tiles are traced, and of tracing them; and both by the plain form."""
    scene = Scene()
    scene.put("mesh", still.vertices, still.triangles)
    bounds = Bounds(max_triangles=len(still.triangles), max_rays=still.depth.size)
    camera, plain = (PrimaryRays(pick_device("cpu"), bounds, wide=wide) for wide in (True, False))
    expected = plain.render(scene, still.camera)
    begin = time.process_time()
    scene.deform("mesh", still.vertices)
    plain.render(scene, still.camera)
    scalar = 1e3 * (time.process_time() - begin)
    tracing = [0.0]
    launch = wp.launch

    def timed_launch(kernel: Any, *args: Any, **settings: Any) -> Any:
        begin = time.process_time()
        done = launch(kernel, *args, **settings)
        if kernel.key == "trace_tiles":
            tracing[0] += time.process_time() - begin
        return done

    times = []
    for _ in range(frames + 1):
        tracing[0] = 0.0
        begin = time.process_time()
        with mock.patch.object(wp, "launch", timed_launch):
            scene.deform("mesh", still.vertices)
            seen = camera.render(scene, still.camera)
        whole = time.process_time() - begin
        if tracing[0] == 0.0:
            raise SystemExit("no launch of trace_tiles was seen")
        times.append((whole - tracing[0], tracing[0]))
        if not (np.array_equal(seen.triangle, expected.triangle) and seen.depth.tobytes() == expected.depth.tobytes()):
            raise SystemExit(f"{still.name}: the depth image is not that of the plain form")
    return _least(times), scalar


def _models(known: list[Still], size: int, procedural_only: bool) -> list[Still]:
    """The paper's models there are data for, and those that are ``known`` already."""
    stills = list(known)
    if not procedural_only:
        for view in views(size, ["Sibenik", "conference"]):
            vertices = view.positions[0]
            depth = photograph(vertices, view.triangles, view.camera, view.pixels)
            name = view.name.capitalize()
            stills.append(Still(name, vertices, view.triangles, view.camera, depth, view.light, view.bias))
    for name in PAPER:
        if name not in (still.name for still in stills):
            print(f"Table 1 without {name}: there is no such model here")
    return stills


def measure(known: list[Still], size: int, frames: int, procedural_only: bool) -> list[dict[str, Any]]:
    """Print the table and return its rows."""
    rows: list[dict[str, Any]] = []
    for still in _models(known, size, procedural_only):
        bench = Bench([still], "cpu", False)
        shadows = {}
        for variant in ("spherical", "packed"):
            bench.tracer.select("light_grid", variant)
            bench.tracer.warm_up()
            shadows[variant] = bench.measure(still, frames).milliseconds
        (structure, tracing), scalar = primary(still, frames)
        paper = PAPER.get(still.name)
        rows.append(
            {
                "model": still.name,
                "triangles": len(still.triangles),
                "Embree": embree(still, frames),
                "wp.Mesh": warp_mesh(still, frames),
                "primary": (structure, tracing),
                "with shadows, spherical": scalar + shadows["spherical"],
                "with shadows, packed": structure + tracing + shadows["packed"],
                "primary, scalar": scalar,
                # A frame with shadows in parts of one without; spherical is scalar, packed vectorised.
                "with/without, spherical": 1.0 + shadows["spherical"] / scalar,
                "with/without, packed": 1.0 + shadows["packed"] / (structure + tracing),
                "with/without, paper": paper[3] / (paper[1] + paper[2]) if paper else None,
            }
        )
    print("\nAs Table 1, ms; structure / tracing. Others and ours on one CPU core")
    table([{key: _pair(value) for key, value in row.items()} for row in rows])
    print(flush=True)
    return rows


def _pair(value: Any) -> Any:
    return f"{value[0]:.1f} / {value[1]:.1f}" if isinstance(value, tuple) else value
