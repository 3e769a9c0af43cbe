# SPDX-License-Identifier: Apache-2.0
"""One row of a dose map beside Embree and Open3D: which points of a tube reach the texels of a room.

    python benchmark/dose.py

The mesh is a new one each time: ours is ``scene.deform`` and ``tracer.light_bits``, the others' is building and asking
about as many rays as there are texels and points, which were made before. Medians of processor time, methods in turn,
so that others may work beside it. Bits of ours are compared with those of ``mesh_bvh``; peers answer in float32 and
with their own idea of edges, and the share of pairs in which they differ is printed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
from report import finish, header
from rivals import missing

from shadow_tracer import Bounds, ShadowTracer, TubeLight
from shadow_tracer.apps.demo import hospital
from shadow_tracer.scene.mesh import Scene
from shadow_tracer.scene.texels import cut

_EDGE, _LIFT = 0.1216, 1e-3
_OURS = ("bvh/sah", "mesh_bvh/refit", "light_grid/packed")


class Room:
    """The demo's hospital room, whose triangles are the texels.

    Attributes:
        vertices, triangles: of the room; points: (N, 3) a millimetre in front of each triangle.
    """

    def __init__(self, edge: float) -> None:
        made = hospital.room()
        texels = cut(Scene(Bounds(max_triangles=10_000)).put("room", made.vertices, made.triangles), edge)
        corners = texels.corners.reshape(-1, 3)
        self.vertices, inverse = np.unique(corners, axis=0, return_inverse=True)
        self.triangles = inverse.reshape(-1, 3).astype(np.int32)
        self.points = texels.centres + _LIFT * texels.normals

    def moved(self, step: int) -> np.ndarray:
        """Its vertices, a little elsewhere."""
        return self.vertices * (1.0 + 1e-9 * step)


def tube(samples: int) -> TubeLight:
    """A metre of it, as high as a robot carries it."""
    return TubeLight("uv", (0.4, -0.3, 0.55), (0.4, -0.3, 1.55), 0.013, samples=samples)


def ours(names: str, room: Room) -> Callable[[int, TubeLight], np.ndarray]:
    """A tracer of ours: (K, N) whether point k reaches texel n."""
    count = len(room.triangles)
    tracer = ShadowTracer(
        *names.split("/"), device="cpu", bounds=Bounds(max_triangles=count, max_rays=count), threads=1
    )
    tracer.scene.put("room", room.vertices, room.triangles)

    def run(step: int, lamp: TubeLight) -> np.ndarray:
        tracer.scene.deform("room", room.moved(step))
        bits = tracer.light_bits(room.points, [lamp])[0]
        return (
            np.unpackbits(bits.view(np.uint8).reshape(-1, 8), axis=1, bitorder="little").T[: lamp.samples].astype(bool)
        )

    return run


def _rays(room: Room, lamp: TubeLight) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ways to the points, (K N, 3) float32; ways as long as rays are."""
    ways = (lamp.points[:, None] - room.points).reshape(-1, 3).astype(np.float32)
    return np.tile(room.points.astype(np.float32), (lamp.samples, 1)), ways


def embree(room: Room) -> Callable[[int, TubeLight], np.ndarray]:
    """Embree through embreex."""
    from embreex import mesh_construction, rtcore_scene

    kept: dict[int, Any] = {}

    def run(step: int, lamp: TubeLight) -> np.ndarray:
        if lamp.samples not in kept:
            starts, ways = _rays(room, lamp)
            length = np.linalg.norm(ways, axis=1)
            kept[lamp.samples] = starts, ways / length[:, None], length
            return np.zeros(0, bool)
        starts, ways, length = kept[lamp.samples]
        scene = rtcore_scene.EmbreeScene()
        mesh_construction.TriangleMesh(scene, room.moved(step).astype(np.float32), room.triangles)
        free: np.ndarray = scene.run(starts, ways, dists=length.copy(), query="OCCLUDED") == -1
        return free.reshape(lamp.samples, -1)

    return run


def open3d(room: Room) -> Callable[[int, TubeLight], np.ndarray]:
    """Open3D's RaycastingScene."""
    import open3d as o3d

    kept: dict[int, Any] = {}

    def run(step: int, lamp: TubeLight) -> np.ndarray:
        if lamp.samples not in kept:
            kept[lamp.samples] = o3d.core.Tensor(np.concatenate(_rays(room, lamp), axis=1))
            return np.zeros(0, bool)
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(
            o3d.core.Tensor(room.moved(step).astype(np.float32)), o3d.core.Tensor(room.triangles.astype(np.uint32))
        )
        hidden: np.ndarray = scene.test_occlusions(kept[lamp.samples], 0.0, 1.0).numpy()
        return ~hidden.reshape(lamp.samples, -1)

    return run


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[8, 16, 32, 64], help="points of the tube")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--edge", type=float, default=_EDGE, help="longest edge of a texel [m]")
    parser.add_argument("--json")
    options = parser.parse_args()
    room, absent = Room(options.edge), missing()
    title = f"Dose: {len(room.triangles):,} texels and a tube"
    header(title)
    methods = {name: ours(name, room) for name in _OURS}
    methods |= {} if "Embree" in absent else {"Embree": embree(room)}
    methods |= {} if "Open3D" in absent else {"Open3D": open3d(room)}
    rows = [_row(room, methods, points, options.repeats) for points in options.points]
    finish(title, rows, options.json)


def _row(room: Room, methods: dict[str, Any], points: int, repeats: int) -> dict[str, Any]:
    """Milliseconds of each, and the pairs in which a peer differs."""
    lamp, times, last = tube(points), {name: [] for name in methods}, {}
    for step in range(repeats + 1):
        for name, run in methods.items():
            begin = time.process_time()
            last[name] = run(step, lamp)
            times[name] += [(time.process_time() - begin) * 1e3] if step else []  # the first loads kernels
    row: dict[str, Any] = {"points": points} | {name: round(median(each), 1) for name, each in times.items()}
    true = last["mesh_bvh/refit"]
    for name in methods:
        wrong = float((last[name] != true).mean())
        if name in _OURS and wrong:
            raise SystemExit(f"{name}: {100 * wrong:.4f} % of the pairs are not those of mesh_bvh")
        if name not in _OURS:
            row[f"{name} differs"] = f"{100 * wrong:.3f} %"
    best = min(row[name] for name in methods if name in _OURS)
    peers = [row[name] for name in methods if name not in _OURS]
    return row | ({"better peer / best of ours": round(min(peers) / best, 2)} if peers else {})


if __name__ == "__main__":
    main()
