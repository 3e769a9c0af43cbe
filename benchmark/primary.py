# SPDX-License-Identifier: Apache-2.0
"""Depth images: ``DepthCamera`` beside wp.Mesh and Embree, the same rays, in the same run, the mesh changed every
frame.

A time is printed only for images that were compared, every one of them. Ours: the wide form's with the plain form's,
bit for bit. Peers, which work in float32: the largest number of pixels that see something else, or at a depth more than
1e-4 away, is in the table; with more than 2 in 1000 of them the program stops, for then somebody is wrong.

Ours is the whole of ``DepthCamera.render``, numpy to numpy; the peers' is structure and query, their rays are made
before the clock starts. CPU time of the calling thread (threads of its own that Embree builds with are not counted);
ratio: better peer with build / ours.
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
from report import compact, header, table, threads, write_json
from scenes import STANDARD, View, names, views

from shadow_tracer import Bounds, DepthCamera, Scene
from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
from shadow_tracer.gpu.device.devices import pick_device

_MOST_DIFFERENT = 2e-3
_COUNTERS = ("entries", "largest_tile", "tests", "retested", "compared")


@wp.kernel(enable_backward=False)
def closest_hit(
    mesh: wp.uint64,
    start: wp.vec3,
    ways: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float),
    ids: wp.array(dtype=int),
):
    i = wp.tid()
    found = wp.mesh_query_ray(mesh, start, ways[i], 1.0e30)
    depth[i] = wp.where(found.result, found.t, float(wp.nan))
    ids[i] = wp.where(found.result, found.face, -1)


class Measurement:
    """One view: reference images of all its frames, and rows of figures."""

    def __init__(self, view: View, frames: int) -> None:
        self.view, self.frames = view, frames
        camera = view.camera
        self._ways = (camera.pixel_rays() @ camera.camera_to_world[:3, :3].T).reshape(-1, 3).astype(np.float32)
        self._start = camera.position.astype(np.float32)
        self._scene = Scene()
        self._scene.put("mesh", view.positions[0], view.triangles)
        rays, count = camera.width * camera.height, len(view.triangles)
        self._ours = DepthCamera("cpu", Bounds(max_triangles=count, max_rays=rays))
        plain = PrimaryRays(pick_device("cpu"), self._ours.bounds, wide=False)
        self._references = []
        for positions in view.positions:
            self._scene.deform("mesh", positions)
            seen = plain.render(self._scene, camera)
            self._references.append((seen.depth, seen.triangle))
        self.rows: list[dict[str, Any]] = []

    def ours(self) -> None:
        """Add our row."""

        def step(frame: int) -> tuple[np.ndarray, np.ndarray]:
            self._scene.deform("mesh", self.view.positions[frame])
            depth, triangle = self._ours.render(self._scene, self.view.camera)
            return depth.ravel(), triangle.ravel()

        self._row("render_depth", step, exact=True)

    def warp_mesh(self) -> None:
        """Add the rows of wp.Mesh, built anew and refitted."""
        positions = [wp.array(p.astype(np.float32), dtype=wp.vec3, device="cpu") for p in self.view.positions]
        indices = wp.array(self.view.triangles.ravel(), dtype=int, device="cpu")
        ways = wp.array(self._ways, dtype=wp.vec3, device="cpu")
        depth = wp.empty(len(self._ways), dtype=float, device="cpu")
        ids = wp.empty(len(self._ways), dtype=int, device="cpu")
        kept = wp.Mesh(wp.clone(positions[0]), indices)

        def query(mesh: wp.Mesh) -> tuple[np.ndarray, np.ndarray]:
            inputs = [mesh.id, wp.vec3(*self._start), ways, depth, ids]
            wp.launch(closest_hit, dim=len(self._ways), inputs=inputs, device="cpu")
            return depth.numpy(), ids.numpy()

        def refit(frame: int) -> tuple[np.ndarray, np.ndarray]:
            wp.copy(kept.points, positions[frame])
            kept.refit()
            return query(kept)

        self._row("wp.Mesh build + mesh_query_ray", lambda frame: query(wp.Mesh(wp.clone(positions[frame]), indices)))
        self._row("wp.Mesh refit + mesh_query_ray", refit)

    def embree(self) -> None:
        """Add the row of Embree."""
        starts = np.tile(self._start, (len(self._ways), 1))

        def step(frame: int) -> tuple[np.ndarray, np.ndarray]:
            scene = rtcore_scene.EmbreeScene()
            TriangleMesh(scene, self.view.positions[frame].astype(np.float32), self.view.triangles)
            hits = scene.run(starts, self._ways, query="INTERSECT", output=1)
            return np.asarray(hits["tfar"]), np.asarray(hits["primID"])

        self._row("Embree build + closest", step)

    def _row(self, method: str, step: Callable[[int], tuple[np.ndarray, np.ndarray]], exact: bool = False) -> None:
        times, different = [], 0
        for k in range(self.frames + 1):
            frame = k % len(self._references)
            begin = time.thread_time()
            depth, ids = step(frame)
            times.append(1e3 * (time.thread_time() - begin))
            different = max(different, _different(depth, ids, *self._references[frame], exact))
        if different > (0 if exact else _MOST_DIFFERENT * len(self._ways)):
            raise SystemExit(f"{self.view.name}: {method} differs in {different} of {len(self._ways)} pixels")
        counters = self._ours.counters if exact else {}
        self.rows.append(
            {
                "view": self.view.name,
                "triangles": len(self.view.triangles),
                "rays": len(self._ways),
                "method": method,
                "median ms": float(np.median(times[1:])),
                "least ms": min(times[1:]),
                "ratio": None,
                "pixels different": different,
                **{name: counters.get(name) for name in _COUNTERS},
            }
        )

    def finish(self) -> list[dict[str, Any]]:
        """Fill in the ratio; returns the rows, best first."""
        best = min(row["median ms"] for row in self.rows if "build" in row["method"])
        for row in self.rows:
            if row["method"] == "render_depth":
                row["ratio"] = best / row["median ms"]
        self.rows.sort(key=lambda row: row["median ms"])
        return self.rows


def _different(depth: np.ndarray, ids: np.ndarray, true_depth: np.ndarray, true_ids: np.ndarray, exact: bool) -> int:
    if exact:
        return int(((depth.view(np.int32) != true_depth.view(np.int32)) | (ids != true_ids)).sum())
    both = (ids >= 0) & (true_ids >= 0)
    off = np.zeros(len(ids), bool)
    off[both] = np.abs(depth[both] - true_depth[both]) > 1e-4 * true_depth[both]
    return int((((ids >= 0) != (true_ids >= 0)) | off).sum())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height [px]")
    parser.add_argument("--frames", type=int, default=7, help="frames per figure")
    parser.add_argument("--views", nargs="+", choices=names(), default=list(STANDARD), metavar="VIEW", help="which")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    confined = threads(1)
    title = f"Depth images, {options.size} x {options.size}, one thread for each method"
    header(title)
    print(confined + "\n")
    rows: list[dict[str, Any]] = []
    for view in views(options.size, options.views):
        measurement = Measurement(view, options.frames)
        measurement.embree()
        measurement.warp_mesh()
        measurement.ours()
        found = measurement.finish()
        rows += found
        print(f"{view.name}: {len(view.triangles):,} triangles")
        table([{k: compact(v) if k in _COUNTERS else v for k, v in row.items() if k != "view"} for row in found])
        print(flush=True)
        write_json(title, rows, options.json)


if __name__ == "__main__":
    main()
