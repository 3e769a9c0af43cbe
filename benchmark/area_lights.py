# SPDX-License-Identifier: Apache-2.0
"""Lights of 64 points: bundles and hard lights of ours beside 64 rays per sample of Embree and Open3D.

Methods take turns in one process on one core; times are processor time, medians (of peers, which are slow, one turn).
Ours is the whole of ``ShadowTracer.trace``, from depth image to bits; a peer's is its query alone, on rays that are
there. Our bits must be equal, or the program stops; of a peer the samples that differ are counted.

A light's size is half a panel's side, or a sphere's radius, in parts of the diagonal of the box around the samples.
*fixture*: the panel below a dome of triangles that casts shadow; *ignored*: the dome is there, and the light ignores it
(peers have a scene without it). *one hard light* is its middle by ``light_grid``.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
from case import FrameRays, shots
from report import header, table, write_json
from scenes import View, views

from shadow_tracer import Bounds, PointLight, RectangleLight, ShadowTracer, SphereLight
from shadow_tracer.scene.lights import AreaLight

VIEWS = ("BART robots", "Sponza", "Sibenik", "conference", "livingroom1", "redkitchen")
_OURS = ("bvh/sah", "light_grid/packed")
_AT_ONCE = 1 << 14  # samples whose 64 rays a peer is given at once


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Milliseconds of the processor, and what the call returns."""
    begin = time.process_time()
    found = call()
    return (time.process_time() - begin) * 1e3, found


def _dome(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A half sphere above a lamp, 48 by 24 quads."""
    around, down = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi / 2, 25))
    places = np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)], axis=-1)
    corner = np.arange(25 * 49).reshape(25, 49)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]).astype(np.int32)
    return centre + radius * places.reshape(-1, 3), triangles


class Peer:
    """Rays from biased samples to all points of a light, some samples at a time: one thread."""

    def __init__(self, name: str, vertices: np.ndarray, triangles: np.ndarray) -> None:
        self.name = name
        if name == "Embree":
            from embreex import rtcore_scene
            from embreex.mesh_construction import TriangleMesh

            self._scene: Any = rtcore_scene.EmbreeScene()
            TriangleMesh(self._scene, vertices.astype(np.float32), triangles)
        else:
            import open3d

            self._scene = open3d.t.geometry.RaycastingScene(nthreads=1)
            self._scene.add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
            self._tensor = open3d.core.Tensor

    def hidden(self, starts: np.ndarray, ways: np.ndarray) -> tuple[float, np.ndarray]:
        """Of rays to the ends of their ways: milliseconds, and which are hidden."""
        if self.name == "Embree":
            far = np.ones(len(starts), np.float32)
            spent, found = _timed(lambda: self._scene.run(starts, ways, dists=far, query="OCCLUDED"))
            return spent, np.asarray(found) != -1
        rays = self._tensor(np.concatenate([starts, ways], axis=1))
        spent, hits = _timed(lambda: self._scene.test_occlusions(rays, tnear=0.0, tfar=1.0, nthreads=1))
        return spent, hits.numpy()

    def bits(self, samples: np.ndarray, light: AreaLight, bias: float) -> tuple[float, np.ndarray]:
        """Milliseconds of all queries, and the bits."""
        total, bits = 0.0, np.zeros(len(samples), np.uint64)
        points = light.homogeneous_points[:, :3]
        for first in range(0, len(samples), _AT_ONCE):
            some = samples[first : first + _AT_ONCE]
            ways = points[None] - some[:, None]
            starts = some[:, None] + ways * (bias / np.linalg.norm(ways, axis=2, keepdims=True))
            ends = (points[None] - starts).astype(np.float32).reshape(-1, 3)
            spent, hidden = self.hidden(starts.astype(np.float32).reshape(-1, 3), ends)
            total += spent
            reach = ~hidden.reshape(len(some), -1)
            powers = np.left_shift(np.uint64(1), np.arange(reach.shape[1], dtype=np.uint64))
            bits[first : first + _AT_ONCE] = (reach * powers).sum(axis=1, dtype=np.uint64)
        return total, bits


def _light(kind: str, view: View, radius: float) -> AreaLight:
    at = view.light.position
    if kind == "sphere":
        return SphereLight("light", at, radius, samples=64)
    ignore = ("dome",) if kind == "ignored" else ()
    return RectangleLight("light", at, (radius, 0.0, 0.0), (0.0, 0.0, radius), two_sided=True, ignore=ignore)


def installed(vertices: np.ndarray, triangles: np.ndarray) -> list[Peer]:
    """Peers that are, with a scene."""
    found = []
    for name in ("Embree", "Open3D"):
        try:
            found.append(Peer(name, vertices, triangles))
        except ImportError:
            print(f"{name} is not installed")
    return found


def measure(view: View, kind: str, percent: float, turns: int) -> dict[str, Any]:
    """A row."""
    shot = shots(view, 1)[0]
    rays = FrameRays(shot, [view.light], view.bias)
    diagonal = float(np.linalg.norm(np.ptp(rays.points, axis=0)))
    radius = diagonal * percent / 100.0
    light = _light(kind, view, radius)
    vertices, triangles = view.positions[0], view.triangles
    meshes = {"mesh": (vertices, triangles)}
    if kind in ("fixture", "ignored"):
        meshes["dome"] = _dome(np.asarray(view.light.position), 1.6 * radius)
    if kind == "fixture":
        more, faces = meshes["dome"]
        vertices, triangles = np.concatenate([vertices, more]), np.concatenate([triangles, faces + len(vertices)])
    count = sum(len(faces) for _, faces in meshes.values())
    bounds = Bounds(max_triangles=count, max_rays=shot.depth.size, max_lights=8)
    tracers = {name: ShadowTracer(*name.split("/"), device="cpu", bounds=bounds, threads=1) for name in _OURS}
    for tracer in tracers.values():
        for name, mesh in meshes.items():
            tracer.scene.put(name, *mesh)
    peers = installed(vertices, triangles)
    hard = PointLight("light", view.light.position)
    spent: dict[str, list[float]] = {name: [] for name in (*_OURS, *(peer.name for peer in peers), "hard")}
    row: dict[str, Any] = {"view": view.name, "light": f"{kind}, {percent:g} %", "samples": len(rays.points)}
    right: np.ndarray | None = None
    for turn in range(turns + 1):
        for name, tracer in tracers.items():
            took, frame = _timed(lambda use=tracer: use.trace(shot.depth, shot.camera, [light], view.bias))
            bits = frame.light_bits("light").ravel()[rays.valid]
            right = bits if right is None else right
            if not np.array_equal(bits, right):
                raise SystemExit(f"{view.name}: {name} differs in {(bits != right).sum()} samples")
            if name == "bvh/sah":
                row["shown"] = round(frame.counters["leaf_tests"] / len(rays.points), 1)
            spent[name].append(took)
        grid = tracers["light_grid/packed"]
        spent["hard"].append(_timed(lambda use=grid: use.trace(shot.depth, shot.camera, [hard], view.bias))[0])
        if turn == turns:  # slow: once
            for peer in peers:
                took, bits = peer.bits(rays.points, light, view.bias)
                spent[peer.name].append(took)
                row[f"{peer.name} differs"] = int((bits != right).sum())
    row |= {name: round(median(times[1:] or times), 1) for name, times in spent.items()}
    best, ours = min(row[peer.name] for peer in peers), row["bvh/sah"]
    ways = min(row["bvh/sah"], row["light_grid/packed"])
    row |= {"peer / ours": round(best / ours, 1), "ours / hard": round(ours / row["hard"], 1)}
    return row | {"ours / better way": round(ours / ways, 2)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height [px]")
    parser.add_argument("--views", nargs="+", default=list(VIEWS), metavar="VIEW")
    parser.add_argument("--sizes", nargs="+", type=float, default=[1, 5, 10, 20], help="per cent of the view")
    parser.add_argument("--kinds", nargs="+", default=["panel"], choices=["panel", "sphere", "fixture", "ignored"])
    parser.add_argument("--turns", type=int, default=3, help="of which the median is given")
    parser.add_argument("--json", help="a file for the rows")
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    title = "lights of 64 points beside 64 rays per sample [ms]"
    header(title)
    rows = []
    for view in views(options.size, options.views):
        for percent in options.sizes:
            for kind in options.kinds:
                rows.append(measure(view, kind, percent, options.turns))
                print(rows[-1], flush=True)
    table(rows)
    write_json(title, rows, options.json)


if __name__ == "__main__":
    main()
