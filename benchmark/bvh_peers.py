# SPDX-License-Identifier: Apache-2.0
"""Pipeline ``bvh`` beside Embree, ``wp.Mesh`` and ``mesh_bvh``: build, refit and any hit, each apart.

Methods take turns in one process, medians. With one thread (``--threads 1``) times are processor time, with several
wall time, of the slowest of ours: then nobody else should use the machine. *any hit* is what stands between rays and
answers: Embree's and Warp's query on rays that are there, our walk on rays in the light's frame, exact decision and
all. Trees were built for other positions of the same mesh and refitted, except for Embree's, which is built. *whole* is
``ShadowTracer.trace``, from depth image to mask. The answers of every query are compared: one of ours that is not that
of ``mesh_bvh`` stops the program.

``single`` sends rays one by one through the tree of ``sah``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
from case import Case, hidden
from report import header, table, threads, write_json
from rivals import Embree, WarpMesh, missing
from scenes import View, views

from shadow_tracer import ShadowTracer

REAL = ("BART robots", "Sponza", "Sibenik", "conference")
_VARIANTS = ("bvh/sah", "bvh/sah single", "bvh/median", "bvh/lbvh", "bvh/threaded", "mesh_bvh/refit")


class _Clock:
    """Of the processor with one thread, else that on the wall."""

    def __init__(self, threads: int) -> None:
        self.now: Callable[[], float] = time.process_time if threads == 1 else time.perf_counter

    def timed(self, call: Callable[[], Any]) -> tuple[float, Any]:
        """Milliseconds, and what the call returns."""
        begin = self.now()
        found = call()
        return (self.now() - begin) * 1e3, found


class _Ours:
    """A tracer whose stages are timed apart."""

    def __init__(self, name: str, case: Case, clock: _Clock, threads: int) -> None:
        self.name, self._case, self._clock = name, case, clock
        names = name.split(" ")[0].split("/")
        self._tracer = ShadowTracer(*names, device="cpu", bounds=case.bounds(), threads=threads)
        if name.endswith("single"):
            from shadow_tracer.gpu.accelerators.bvh.bvh import SINGLE

            walker: Any = self._tracer._engine.inside._bands[0].pipeline
            walker.build.walk = SINGLE
        self._turn = 0

    def _trace(self, frame: int) -> tuple[float, float, float]:
        """Milliseconds of the structure, of the walk, and of all."""
        shot, lights, bias = self._case.frames[frame].shot, self._case.lights, self._case.view.bias
        with mock.patch("shadow_tracer.gpu.device.stages.time", SimpleNamespace(perf_counter=self._clock.now)):
            whole, found = self._clock.timed(lambda: self._tracer.trace(shot.depth, shot.camera, lights, bias=bias))
        wrong = int((hidden(found, lights, self._case.frames[frame]) != self._case.dynamic[frame]).sum())
        if wrong:
            raise SystemExit(f"{self._case.view.name}: {self.name} differs from mesh_bvh in {wrong} rays")
        return found.stages.get("build", 0.0), found.stages["trace"], whole

    def turn(self) -> dict[str, float]:
        """Build, refit, and ask."""
        view = self._case.view
        self._turn += 1
        # Other triangles at the same places: another topology, and no other answer.
        self._tracer.scene.put("mesh", view.positions[1], np.roll(view.triangles, self._turn, axis=0))
        build = self._trace(1)[0]
        self._tracer.scene.deform("mesh", view.positions[0])
        refit = self._trace(0)[0]
        _, query, whole = self._trace(0)
        return {"build ms": build, "refit ms": refit, "any hit ms": query, "whole ms": whole, "wrong": 0}


class _Embree:
    """Embree, which is built for each frame."""

    name = "Embree"

    def __init__(self, case: Case, clock: _Clock) -> None:
        self._case, self._peer, self._clock = case, Embree(case), clock

    def turn(self) -> dict[str, float]:
        """Build and ask."""
        both, _ = self._clock.timed(lambda: self._peer.dynamic(0))
        query, found = self._clock.timed(lambda: self._peer.static(0))
        return {
            "build ms": both - query,
            "any hit ms": query,
            "wrong": self._peer.wrong(0, found, self._case.dynamic[0]),
        }


class _WarpMesh:
    """``wp.Mesh``, built once a turn, then refitted."""

    name = "wp.Mesh"

    def __init__(self, case: Case, clock: _Clock) -> None:
        self._case, self._clock = case, clock
        self._built, self._refitted = WarpMesh(case, build=True), WarpMesh(case, build=False)

    def turn(self) -> dict[str, float]:
        """Build, refit, and ask."""
        built, _ = self._clock.timed(lambda: self._built.dynamic(0))
        first, _ = self._clock.timed(lambda: self._built.static(0))
        self._refitted.dynamic(1)
        refitted, _ = self._clock.timed(lambda: self._refitted.dynamic(0))
        query, found = self._clock.timed(lambda: self._refitted.static(0))
        wrong = self._refitted.wrong(0, found, self._case.dynamic[0])
        return {"build ms": built - first, "refit ms": refitted - query, "any hit ms": query, "wrong": wrong}


def measure(view: View, turns: int, cores: int) -> list[dict[str, Any]]:
    """Rows of a view."""
    case, clock = Case(view, 2), _Clock(cores)
    methods: list[Any] = [_Embree(case, clock)] if "Embree" not in missing() else []
    methods += [_WarpMesh(case, clock), *(_Ours(name, case, clock, cores) for name in _VARIANTS)]
    taken: dict[str, list[dict[str, float]]] = {method.name: [] for method in methods}
    for turn in range(turns + 1):
        for method in methods:
            found = method.turn()
            if turn:  # the first one loads kernels
                taken[method.name].append(found)
    rows = []
    for method in methods:
        row: dict[str, Any] = {"view": view.name, "threads": cores, "method": method.name}
        for column in ("build ms", "refit ms", "any hit ms", "whole ms"):
            times = [found[column] for found in taken[method.name] if column in found]
            row[column] = round(median(times), 2) if times else ""
        ours = row["any hit ms"]
        row["ns per ray"] = round(1e6 * ours / case.rays, 1)
        row["in parts of Embree's"] = round(ours / rows[0]["any hit ms"], 2) if rows else 1.0
        row["wrong rays"] = max(int(found["wrong"]) for found in taken[method.name])
        rows.append(row)
    size = f"{len(view.triangles):,} triangles, {case.rays:,} rays"
    print(f"\n{view.name}: {size}, {100 * case.in_shadow:.0f} % in shadow\n")
    table([{name: value for name, value in row.items() if name != "view"} for row in rows])
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height [px]")
    parser.add_argument("--views", nargs="+", default=list(REAL), metavar="VIEW")
    parser.add_argument("--turns", type=int, default=9, help="of which the median is given")
    parser.add_argument("--threads", type=int, default=1, help="of each method")
    parser.add_argument("--json", help="a file for the rows")
    options = parser.parse_args()
    header("bvh beside its peers")
    print(threads(options.threads))
    rows: list[dict[str, Any]] = []
    for view in views(options.size, options.views):
        rows += measure(view, options.turns, options.threads)
        write_json("bvh beside its peers", rows, options.json)


if __name__ == "__main__":
    main()
