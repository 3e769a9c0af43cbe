# SPDX-License-Identifier: Apache-2.0
"""Pipelines beside Embree and wp.Mesh: the same rays, in the same run, one thread each, the mesh changed every frame.

A time is printed only for a mask that was compared. Ours: every pixel against ``mesh_bvh``'s rival variant and a random
subset against ``brute_force``, which must be equal. Peers: the number of pixels in which they differ is in the table.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from report import finish
from scenes import View, views

from shadow_tracer import Bounds, PointLight, ShadowTracer, State, available_pipelines

_SUBSET = 1500


@wp.kernel(enable_backward=False)
def any_hit(
    mesh: wp.uint64,
    starts: wp.array(dtype=wp.vec3),
    ways: wp.array(dtype=wp.vec3),
    reach: wp.array(dtype=float),
    out: wp.array(dtype=wp.uint8),
):
    i = wp.tid()
    out[i] = wp.uint8(0)
    if wp.mesh_query_ray_anyhit(mesh, starts[i], ways[i], reach[i]):
        out[i] = wp.uint8(1)


class Rays:
    """The shadow rays of a view as float32 starts, unit directions and lengths, valid pixels only."""

    def __init__(self, view: View) -> None:
        self.depth = _depth(view)
        points = view.camera.unproject(self.depth).reshape(-1, 3)
        self.valid = np.isfinite(points).all(axis=1)
        points = points[self.valid]
        way = view.light - points
        distance = np.linalg.norm(way, axis=1, keepdims=True)
        self.starts = (points + view.bias * way / distance).astype(np.float32)
        self.ways = (way / distance).astype(np.float32)
        self.reach = (distance[:, 0] - view.bias).astype(np.float32)


def _depth(view: View) -> np.ndarray:
    directions = (view.camera.pixel_rays() @ view.camera.camera_to_world[:3, :3].T).reshape(-1, 3).astype(np.float32)
    starts = np.tile(view.camera.position.astype(np.float32), (len(directions), 1))
    hit = _embree(view, 0).run(starts, directions, output=1)
    depth = hit["tfar"].astype(np.float32)
    depth[hit["primID"] < 0] = np.nan
    return depth.reshape(view.camera.height, view.camera.width)


def _embree(view: View, frame: int) -> Any:
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, view.positions[frame].astype(np.float32)[view.triangles])
    return scene


def _median(step: Callable[[int], Any], frames: int) -> float:
    """Median milliseconds of ``step(k)`` after one call to warm up."""
    times = []
    for k in range(frames + 1):
        begin = time.perf_counter()
        step(k)
        times.append((time.perf_counter() - begin) * 1e3)
    return float(np.median(times[1:]))


def measure(view: View, frames: int) -> list[dict[str, Any]]:
    """Rows of the table for one view."""
    rays = Rays(view)
    count = len(view.positions)
    light = PointLight("lamp", view.light)
    bounds = Bounds(max_triangles=len(view.triangles), max_rays=view.camera.width * view.camera.height)
    tracer = ShadowTracer("brute_force", device="cpu", bounds=bounds)
    reference = _reference(tracer, view, rays, light)
    rows = []

    def row(name: str, milliseconds: float, mask: np.ndarray) -> None:
        rows.append(
            {
                "view": view.name,
                "triangles": len(view.triangles),
                "rays": len(rays.starts),
                "method": name,
                "ms": milliseconds,
                "pixels different": int((mask != reference).sum()),
            }
        )

    for name, variants in available_pipelines().items():
        for variant in variants:
            if name == "brute_force":
                continue
            tracer.select(name, variant)

            def dynamic(k: int) -> np.ndarray:
                tracer.scene.deform("mesh", view.positions[k % count])
                return tracer.trace(rays.depth, view.camera, [light], bias=view.bias).state("lamp")

            spent = _median(dynamic, frames)
            row(f"{name}/{variant}, dynamic", spent, dynamic(0).ravel()[rays.valid] == State.SHADOWED)
            static = _median(lambda k: tracer.trace(rays.depth, view.camera, [light], bias=view.bias), frames)
            row(f"{name}/{variant}, static", static, dynamic(0).ravel()[rays.valid] == State.SHADOWED)
    _measure_warp(view, rays, frames, row)
    _measure_embree(view, rays, frames, row)
    return rows


def _reference(tracer: ShadowTracer, view: View, rays: Rays, light: PointLight) -> np.ndarray:
    """The mask of mesh_bvh, compared with brute_force on a random subset of the samples."""
    tracer.scene.put("mesh", view.positions[0], view.triangles)
    chosen = np.random.default_rng(0).choice(len(rays.starts), min(_SUBSET, len(rays.starts)), replace=False)
    points = view.camera.unproject(rays.depth).reshape(-1, 3)[rays.valid]
    expected = tracer.occluded(points[chosen], light, bias=view.bias)
    tracer.select("mesh_bvh")
    mask = tracer.trace(rays.depth, view.camera, [light], bias=view.bias).state("lamp").ravel()[rays.valid]
    reference: np.ndarray = mask == State.SHADOWED
    if not np.array_equal(reference[chosen], expected):
        raise SystemExit(
            f"{view.name}: mesh_bvh differs from brute_force in {(reference[chosen] != expected).sum()} samples"
        )
    return reference


def _measure_warp(view: View, rays: Rays, frames: int, row: Callable[[str, float, np.ndarray], None]) -> None:
    positions = [wp.array(p.astype(np.float32), dtype=wp.vec3, device="cpu") for p in view.positions]
    indices = wp.array(view.triangles.ravel(), dtype=int, device="cpu")
    arrays = [
        wp.array(a, dtype=t, device="cpu")
        for a, t in ((rays.starts, wp.vec3), (rays.ways, wp.vec3), (rays.reach, float))
    ]
    out = wp.zeros(len(rays.starts), dtype=wp.uint8, device="cpu")

    def query(mesh: wp.Mesh) -> None:
        wp.launch(any_hit, dim=len(rays.starts), inputs=[mesh.id, *arrays, out], device="cpu")

    build = _median(lambda k: query(wp.Mesh(wp.clone(positions[k % len(positions)]), indices)), frames)
    mesh = wp.Mesh(wp.clone(positions[0]), indices)

    def refit(k: int) -> None:
        wp.copy(mesh.points, positions[k % len(positions)])
        mesh.refit()
        query(mesh)

    refitted = _median(refit, frames)
    refit(0)
    static = _median(lambda k: query(mesh), frames)
    mask = out.numpy() == 1
    row("wp.Mesh build + any-hit", build, mask)
    row("wp.Mesh refit + any-hit", refitted, mask)
    row("wp.Mesh any-hit, static", static, mask)


def _measure_embree(view: View, rays: Rays, frames: int, row: Callable[[str, float, np.ndarray], None]) -> None:
    def occluded(scene: Any) -> np.ndarray:
        # embreex shortens the length array in place of returning distances; a copy keeps ours.
        return scene.run(rays.starts, rays.ways, dists=rays.reach.copy(), query="OCCLUDED") != -1

    build = _median(lambda k: occluded(_embree(view, k % len(view.positions))), frames)
    scene = _embree(view, 0)
    mask = occluded(scene)
    row("Embree build + occluded", build, mask)
    row("Embree occluded, static", _median(lambda k: occluded(scene), frames), mask)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=512, help="image width and height [px]")
    parser.add_argument("--frames", type=int, default=7)
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    rows = [line for view in views(options.size) for line in measure(view, options.frames)]
    finish("Shadow rays of one point light, one thread", rows, options.json)


if __name__ == "__main__":
    main()
