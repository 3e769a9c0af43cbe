# SPDX-License-Identifier: Apache-2.0
"""Who takes part: our pipelines, brute force on a few samples, and Embree, wp.Mesh and Open3D on rays that were made
before the clock starts."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar

import numpy as np
import warp as wp
from case import SUBSET, Case, LightRays, hidden

from shadow_tracer import Bounds, ShadowTracer


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


class Contestant:
    """One way to find the shadows of a case.

    Attributes:
        name: its row in tables.
        exact: one of ours: a wrong pixel stops everything.
        builds: a peer that makes its structure anew when the mesh changes.
        rays: rays it answers per frame.
    """

    exact = False
    builds = False

    def __init__(self, name: str, case: Case) -> None:
        self.name, self.case, self.rays = name, case, case.rays

    def dynamic(self, frame: int) -> Any:
        """What is timed when mesh and image are new: structure and query; what it returns is for ``answer``."""
        raise NotImplementedError

    def settle(self) -> None:
        """Take the mesh of frame 0 for ``static``; not timed."""
        raise NotImplementedError

    def static(self, frame: int) -> Any:
        """What is timed when only the image is new."""
        raise NotImplementedError

    def wrong(self, frame: int, found: Any, right: np.ndarray) -> int:
        """In how many of the (L, N) ``right`` answers ``found`` differs; not timed."""
        return int((np.stack(found) != right).sum())

    def notes(self) -> dict[str, Any]:
        """Counters and milliseconds per stage of the last frame."""
        return {"counters": {}, "stages": {}}


class _Tracing(Contestant):
    """One of ours: a tracer that holds the mesh of the case."""

    exact = True

    def __init__(self, name: str, case: Case, tracer: ShadowTracer) -> None:
        super().__init__(name, case)
        self._tracer = tracer
        self._tracer.scene.put("mesh", case.view.positions[0], case.view.triangles)
        self._tracer.warm_up()

    def dynamic(self, frame: int) -> Any:
        self._tracer.scene.deform("mesh", self.case.view.positions[frame])
        return self.static(frame)

    def settle(self) -> None:
        self._tracer.scene.deform("mesh", self.case.view.positions[0])


class Ours(_Tracing):
    """A pipeline's variant: the whole of ``ShadowTracer.trace``, numpy to numpy."""

    def __init__(self, pipeline: str, variant: str, case: Case, bounds: Bounds | None = None) -> None:
        tracer = ShadowTracer(pipeline, variant, "cpu", bounds or case.bounds())
        super().__init__(f"{pipeline}/{variant}", case, tracer)

    def static(self, frame: int) -> Any:
        shot = self.case.frames[frame].shot
        self._last = self._tracer.trace(shot.depth, shot.camera, self.case.lights, bias=self.case.view.bias)
        return self._last

    def wrong(self, frame: int, found: Any, right: np.ndarray) -> int:
        return int((hidden(found, self.case.lights, self.case.frames[frame]) != right).sum())

    def notes(self) -> dict[str, Any]:
        return {"counters": dict(self._last.counters), "stages": dict(self._last.stages)}


class Asked(_Tracing):
    """A pipeline's variant: the whole of ``ShadowTracer.occluded``, numpy to numpy, light by light."""

    def __init__(self, pipeline: str, variant: str, case: Case) -> None:
        super().__init__(f"{pipeline}/{variant}", case, ShadowTracer(pipeline, variant, "cpu", case.bounds()))

    def static(self, frame: int) -> Any:
        points, bias = self.case.frames[frame].points, self.case.view.bias
        return [self._tracer.occluded(points, light, bias=bias) for light in self.case.lights]


class BruteForce(_Tracing):
    """Every sample against every triangle, as far as it is affordable: on a random subset of the samples."""

    def __init__(self, variant: str, case: Case, most: int = SUBSET) -> None:
        self._samples = min(most, *(len(frame.points) for frame in case.frames))
        few = self._samples * len(case.lights) < case.rays
        of = f" ({self._samples:,} samples)" if few else ""
        bounds = Bounds(max_triangles=len(case.view.triangles), max_rays=max(self._samples, 1))
        super().__init__(f"brute_force/{variant}{of}", case, ShadowTracer("brute_force", variant, "cpu", bounds))
        self.rays = self._samples * len(case.lights)
        self._chosen = [
            np.sort(np.random.default_rng(k).choice(len(frame.points), self._samples, replace=False))
            for k, frame in enumerate(case.frames)
        ]
        self._points = [frame.points[chosen] for frame, chosen in zip(case.frames, self._chosen, strict=True)]

    def static(self, frame: int) -> Any:
        bias = self.case.view.bias
        return [self._tracer.occluded(self._points[frame], light, bias=bias) for light in self.case.lights]

    def wrong(self, frame: int, found: Any, right: np.ndarray) -> int:
        return super().wrong(frame, found, right[:, self._chosen[frame]])


class _Shares:
    """Pieces of the rays for queries that use one thread each: as many as there are cores that this process may use."""

    def __init__(self) -> None:
        self.count = len(os.sched_getaffinity(0))
        self._pool = ThreadPoolExecutor(self.count) if self.count > 1 else None

    def of(self, total: int) -> list[slice]:
        """Slices that make up ``total`` rays."""
        ends = [total * k // self.count for k in range(self.count + 1)]
        return [slice(begin, end) for begin, end in zip(ends, ends[1:], strict=False)]

    def run(self, query: Callable[[slice], np.ndarray], total: int) -> np.ndarray:
        """The answers of all pieces, one after the other; the queries run side by side."""
        pieces = self.of(total)
        found = map(query, pieces) if self._pool is None else self._pool.map(query, pieces)
        return np.concatenate(list(found))


class Embree(Contestant):
    """Embree through embreex: build and occluded, or occluded alone."""

    builds = True
    needs: ClassVar[str] = "embreex"

    def __init__(self, case: Case) -> None:
        super().__init__("Embree build + occluded", case)
        self._scene_module = importlib.import_module("embreex.rtcore_scene")
        self._mesh_module = importlib.import_module("embreex.mesh_construction")
        self._positions = [positions.astype(np.float32) for positions in case.view.positions]
        self._shares = _Shares()
        self.settle()

    def _build(self, frame: int) -> None:
        self._scene = self._scene_module.EmbreeScene()
        # Shared vertices: built from a soup of corners, the same scene takes twice as long.
        self._mesh_module.TriangleMesh(self._scene, self._positions[frame], self.case.view.triangles)

    def dynamic(self, frame: int) -> Any:
        self._build(frame)
        return self.static(frame)

    def settle(self) -> None:
        self._build(0)

    def static(self, frame: int) -> Any:
        return [self._shares.run(self._query(rays), len(rays.starts)) for rays in self.case.frames[frame].lights]

    def _query(self, rays: LightRays) -> Callable[[slice], np.ndarray]:
        def query(part: slice) -> np.ndarray:
            # embreex shortens the length array in place of returning distances; a copy keeps ours.
            far = rays.reach[part].copy()
            hidden: np.ndarray = self._scene.run(rays.starts[part], rays.ways[part], dists=far, query="OCCLUDED") != -1
            return hidden

        return query


class WarpMesh(Contestant):
    """wp.Mesh and its any-hit query: built anew, or refitted."""

    needs: ClassVar[str] = "warp"

    def __init__(self, case: Case, build: bool) -> None:
        super().__init__(f"wp.Mesh {'build' if build else 'refit'} + any-hit", case)
        self.builds = build
        count = max(len(frame.points) for frame in case.frames)
        self._positions = [wp.array(p.astype(np.float32), dtype=wp.vec3, device="cpu") for p in case.view.positions]
        self._indices = wp.array(case.view.triangles.ravel(), dtype=int, device="cpu")
        self._arrays = [
            [[wp.array(a, dtype=t, device="cpu") for a, t in _typed(rays)] for rays in frame.lights]
            for frame in case.frames
        ]
        self._out = wp.zeros(count, dtype=wp.uint8, device="cpu")
        self._shares = _Shares()
        self._build(0)

    def _build(self, frame: int) -> None:
        self._mesh = wp.Mesh(wp.clone(self._positions[frame]), self._indices)

    def dynamic(self, frame: int) -> Any:
        if self.builds:
            self._build(frame)
        else:
            wp.copy(self._mesh.points, self._positions[frame])
            self._mesh.refit()
        return self.static(frame)

    def settle(self) -> None:
        self._build(0)

    def static(self, frame: int) -> Any:
        count = len(self.case.frames[frame].points)
        return [self._shares.run(self._query(arrays), count) for arrays in self._arrays[frame]]

    def _query(self, arrays: list[wp.array]) -> Callable[[slice], np.ndarray]:
        def query(part: slice) -> np.ndarray:
            size = part.stop - part.start
            out = self._out[part]
            if size:
                wp.launch(any_hit, dim=size, inputs=[self._mesh.id, *(a[part] for a in arrays), out], device="cpu")
            hidden: np.ndarray = out.numpy().view(np.bool_)
            return hidden

        return query


def _typed(rays: LightRays) -> list[tuple[np.ndarray, Any]]:
    return [(rays.starts, wp.vec3), (rays.ways, wp.vec3), (rays.reach, float)]


class Open3D(Contestant):
    """Open3D's RaycastingScene: build and test_occlusions. Its far end is one number for all rays: ways are as long as
    the rays, and it is 1."""

    builds = True
    needs: ClassVar[str] = "open3d"

    def __init__(self, case: Case) -> None:
        super().__init__("Open3D build + test_occlusions", case)
        self._o3d = importlib.import_module("open3d")
        tensor = self._o3d.core.Tensor
        self._positions = [tensor(positions.astype(np.float32)) for positions in case.view.positions]
        self._indices = tensor(case.view.triangles.astype(np.uint32))
        self._rays = [[self._six(rays) for rays in frame.lights] for frame in case.frames]
        self.settle()

    def _six(self, rays: LightRays) -> tuple[Any, float]:
        far = float(rays.reach.max(initial=0.0)) > 1e29
        ways = rays.ways if far else rays.ways * rays.reach[:, None]
        six = np.concatenate([rays.starts, ways], axis=1)
        return self._o3d.core.Tensor(np.ascontiguousarray(six)), np.inf if far else 1.0

    def _build(self, frame: int) -> None:
        self._scene = self._o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._positions[frame], self._indices)

    def dynamic(self, frame: int) -> Any:
        self._build(frame)
        return self.static(frame)

    def settle(self) -> None:
        self._build(0)

    def static(self, frame: int) -> Any:
        return [self._scene.test_occlusions(rays, 0.0, far).numpy() for rays, far in self._rays[frame]]


def missing() -> dict[str, str]:
    """Peers that cannot take part, and why."""
    found = {}
    for peer in (Embree, Open3D):
        try:
            importlib.import_module(peer.needs)
        except (ImportError, OSError) as error:
            found[peer.__name__] = f"{peer.needs}: {error}".splitlines()[0]
    return found


def peers(case: Case) -> list[Contestant]:
    """All peers that are installed, prepared for a case."""
    absent = missing()
    made: list[Contestant] = []
    if "Embree" not in absent:
        made.append(Embree(case))
    made += [WarpMesh(case, build=True), WarpMesh(case, build=False)]
    if "Open3D" not in absent:
        made.append(Open3D(case))
    return made
