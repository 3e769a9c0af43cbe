# SPDX-License-Identifier: Apache-2.0
"""Terrain in the sun: every cell of 1024 x 1024 heights, ``height_field`` beside a hierarchy over the triangles, Embree
and Open3D, in turn, in one run.

Ours is the whole of ``tracer.occluded``, numpy to numpy, the exact decision included, and so is ``mesh_bvh`` without
its build. The peers are charged for the query alone: their structure is built, and their rays are made, before the
clock starts. Embree and Open3D work in float32: cells that they answer otherwise are counted. No time is printed for an
answer that was not compared: ours with ``mesh_bvh`` in every cell, and with ``brute_force`` in a random subset.

Data: ``mars_jezero_neretva`` at 2.02 m, four mirrored copies of it, and ``dem_squared`` at 3.05 m, made eight times as
dense by cubic interpolation and roughened by up to a metre, in ``SHADOW_TRACER_DATA`` or ``../shared/data``.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from report import ROOT, header, note, table, threads, write_json

from shadow_tracer import Bounds, DirectionalLight, HeightField, ShadowTracer
from shadow_tracer.scene.surface import organised

_SIZE = 1024
_SUNS = (2.0, 10.0, 45.0)
_AZIMUTH = 220.0
_DAY = 96


def _data() -> Path:
    named = os.environ.get("SHADOW_TRACER_DATA")
    return Path(named) if named else ROOT.parent / "shared" / "data"


def _mars() -> tuple[np.ndarray, float]:
    with np.load(_data() / "meshes" / "mars_jezero_neretva.npz") as arrays:
        z = arrays["vertices"][:, 2].astype(np.float64).reshape(513, 513)
    return np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]])[:_SIZE, :_SIZE], 1033.0 / 512.0


def _dem() -> tuple[np.ndarray, float]:
    from PIL import Image
    from scipy.ndimage import zoom

    with Image.open(_data() / "dem" / "dem_squared.tif") as image:
        coarse = np.asarray(image, dtype=np.float64)
    z, rng = zoom(coarse, _SIZE / len(coarse), order=3), np.random.default_rng(0)
    for size, rough in ((256, 1.0), (512, 0.5), (1024, 0.25)):
        z += zoom(rng.normal(size=(size, size)) * rough, _SIZE / size, order=1)
    return z, 24.4 * (len(coarse) - 1) / (_SIZE - 1)


def _sun(elevation: float, azimuth: float = _AZIMUTH, name: str = "sun") -> DirectionalLight:
    up, around = np.radians(elevation), np.radians(azimuth)
    towards = np.array([np.sin(around) * np.cos(up), np.cos(around) * np.cos(up), np.sin(up)])
    return DirectionalLight(name, -towards)


class Terrain:
    """Heights, and the methods: of each a function from a sun to what is dark."""

    def __init__(self, name: str, above: float, cores: int) -> None:
        z, resolution = {"mars": _mars, "dem": _dem}[name]()
        self.name, self.field = name, HeightField(z, resolution)
        self.points = self.field.positions().reshape(-1, 3) + (0.0, 0.0, above)
        self.methods: dict[str, Callable[[DirectionalLight], np.ndarray]] = {}
        bounds = Bounds(max_triangles=2 * _SIZE * _SIZE, max_rays=_SIZE * _SIZE, max_lights=16)
        self.ours = {}
        for count in sorted({1, cores}):
            self.ours[count] = self._tracer("height_field", bounds, count)
            self.methods[f"height_field, {count} thread{'s' * (count > 1)}"] = self._asked(self.ours[count])
        self.methods["mesh_bvh"] = self._asked(self._tracer("mesh_bvh", bounds, 1))
        surface = organised(self.field, None)
        self._middle = surface.vertices.mean(axis=0)
        self._vertices = (surface.vertices - self._middle).astype(np.float32)
        self._triangles = surface.triangles()
        self._start = (self.points - self._middle).astype(np.float32)
        for peer, add in (("embreex", self._add_embree), ("open3d", self._add_open3d)):
            if importlib.util.find_spec(peer) is None:
                note(f"{peer} is not installed and not measured")
            else:
                add()

    def _tracer(self, pipeline: str, bounds: Bounds, count: int) -> ShadowTracer:
        tracer = ShadowTracer(pipeline, device="cpu", bounds=bounds, threads=count)
        tracer.scene.put_surface("ground", self.field)
        return tracer

    def _asked(self, tracer: ShadowTracer) -> Callable[[DirectionalLight], np.ndarray]:
        return lambda sun: tracer.occluded(self.points, sun)

    def _add_embree(self) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        scene = rtcore_scene.EmbreeScene()
        mesh = TriangleMesh(scene, self._vertices[self._triangles])

        def ask(sun: DirectionalLight) -> np.ndarray:
            # The mesh has to live as long as the scene.
            assert mesh is not None
            return np.asarray(scene.run(self._start, self._ways(sun), query="OCCLUDED") != -1)

        self.methods["embree, 1 thread"] = ask

    def _add_open3d(self) -> None:
        import open3d

        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(self._vertices, self._triangles.astype(np.uint32))

        def ask(sun: DirectionalLight) -> np.ndarray:
            rays = np.concatenate([self._start, self._ways(sun)], axis=-1)
            return np.asarray(scene.test_occlusions(open3d.core.Tensor(rays)).numpy())

        self.methods["open3d, all cores"] = ask

    def _ways(self, sun: DirectionalLight) -> np.ndarray:
        key = tuple(sun.direction)
        if getattr(self, "_made_for", None) != key:
            self._made_for, way = key, -np.asarray(sun.direction, np.float32)
            self._towards = np.ascontiguousarray(np.broadcast_to(way, self._start.shape))
        return self._towards


def _compare(terrain: Terrain, sun: DirectionalLight, subset: int) -> tuple[np.ndarray, dict[str, int]]:
    """What is dark, and in how many cells others say otherwise."""
    answers = {name: ask(sun) for name, ask in terrain.methods.items()}
    truth = answers["mesh_bvh"]
    some = np.random.default_rng(1).integers(0, len(terrain.points), subset)
    oracle = ShadowTracer("brute_force", device="cpu", bounds=Bounds(max_triangles=2 * _SIZE * _SIZE, max_rays=subset))
    oracle.scene.put_surface("ground", terrain.field)
    assert np.array_equal(oracle.occluded(terrain.points[some], sun), truth[some]), "mesh_bvh differs from brute_force"
    wrong = {name: int((answer != truth).sum()) for name, answer in answers.items()}
    assert not any(count for name, count in wrong.items() if "height_field" in name), wrong
    return truth, wrong


def measure(terrain: Terrain, rounds: int, subset: int) -> list[dict[str, Any]]:
    """A row for each sun and method."""
    rows, rng = [], np.random.default_rng(0)
    for elevation in _SUNS:
        sun = _sun(elevation)
        truth, wrong = _compare(terrain, sun, subset)
        times: dict[str, list[float]] = {name: [] for name in terrain.methods}
        used: dict[str, list[float]] = {name: [] for name in terrain.methods}
        for _ in range(rounds):
            for name in rng.permutation(list(terrain.methods)):
                begin, cpu = time.perf_counter(), time.process_time()
                terrain.methods[name](sun)
                times[name].append((time.perf_counter() - begin) * 1e3)
                used[name].append((time.process_time() - cpu) * 1e3)
        for name in terrain.methods:
            rows.append(
                {
                    "terrain": terrain.name,
                    "sun [deg]": elevation,
                    "dark": float(truth.mean()),
                    "method": name,
                    "median [ms]": float(np.median(times[name])),
                    "best [ms]": min(times[name]),
                    "processor [ms]": float(np.median(used[name])),
                    "otherwise": wrong[name],
                }
            )
    return rows


def measure_day(terrain: Terrain) -> list[dict[str, Any]]:
    """Ninety-six suns from sunrise to sunset at latitude 38 degrees on an equinox, sixteen to a frame."""
    hours = np.radians(np.linspace(-89.0, 89.0, _DAY))
    latitude = np.radians(38.0)
    up = np.degrees(np.arcsin(np.cos(latitude) * np.cos(hours)))
    around = np.degrees(np.arctan2(np.sin(hours), np.cos(hours) * np.sin(latitude))) + 180.0
    suns = [_sun(*place, name=f"sun {k}") for k, place in enumerate(zip(up, around, strict=True))]
    rows = []
    for count, tracer in terrain.ours.items():
        begin, cpu, hidden = time.perf_counter(), time.process_time(), 0
        for first in range(0, _DAY, 16):
            hidden += int((tracer.states_at(terrain.points, suns[first : first + 16]) == 1).sum())
        rows.append(
            {
                "terrain": terrain.name,
                "suns": _DAY,
                "threads": count,
                "seconds": time.perf_counter() - begin,
                "processor [s]": time.process_time() - cpu,
                "dark": hidden / _DAY / len(terrain.points),
            }
        )
    return rows


def main() -> None:
    """Measure, and print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--terrain", nargs="+", choices=["mars", "dem"], default=["mars", "dem"])
    parser.add_argument("--threads", type=int, default=2, help="cores (default: 2)")
    parser.add_argument("--rounds", type=int, default=20, help="times that each method is asked (default: 20)")
    parser.add_argument("--above", type=float, default=0.1, help="height of the samples above the cells [m]")
    parser.add_argument("--subset", type=int, default=300, help="cells that brute_force is asked about")
    parser.add_argument("--json", help="file for the figures")
    arguments = parser.parse_args()
    said = threads(arguments.threads)
    title = f"Terrain in the sun, {_SIZE} x {_SIZE}, samples {arguments.above} m above the ground"
    header(title)
    note(said)
    rows, day = [], []
    for name in arguments.terrain:
        terrain = Terrain(name, arguments.above, arguments.threads)
        rows += measure(terrain, arguments.rounds, arguments.subset)
        day += measure_day(terrain)
    table(rows)
    print()
    table(day)
    write_json(title, [*rows, *day], arguments.json)


if __name__ == "__main__":
    main()
