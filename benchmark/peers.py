# SPDX-License-Identifier: Apache-2.0
"""Pipelines beside Embree and wp.Mesh: the same rays, in the same run, on the same cores, the mesh changed every frame.

A time is printed only for masks that were compared, every one of them. Ours: all pixels with ``mesh_bvh``, and
``mesh_bvh`` on a random subset with ``brute_force``; one difference and the program stops. Peers: the largest number of
pixels in which a mask differs is in the table.

dynamic: the mesh is new (positions). Ours is the whole of ``ShadowTracer.trace``, numpy to numpy; the peers' is
structure and query. static: nothing changed since the frame before; the peers' is the query alone. ratio: better peer
with build / ours.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from report import compact, header, table, threads, write_json
from rivals import Embree, Rays, WarpMesh
from scenes import STANDARD, View, names, views

from shadow_tracer import Bounds, ShadowTracer, State, available_pipelines

_SUBSET = 1500
_BUDGET = 2.0  # seconds of frames per figure, more only if one frame takes longer
_TOO_LONG = 15.0  # seconds per frame from which on nothing is measured that is not asked for
_COUNTERS = ("nodes_visited", "leaf_tests", "accepted", "passes", "peak_queue", "retested")


@dataclass(frozen=True)
class Timing:
    """Median milliseconds of some frames, how many they were, and the largest number of wrong pixels among them."""

    milliseconds: float
    frames: int
    wrong: int


class Stop(SystemExit):
    """Raised on a wrong mask of ours."""


def timed(step: Callable[[int], np.ndarray], references: list[np.ndarray], frames: int) -> Timing:
    """Run ``step(k)`` for frame k: once to warm up, then ``frames`` times, or as often as the budget allows.

    A first frame that alone uses up the budget is the measurement. Comparing masks is not timed.
    """
    times: list[float] = []
    wrong = 0
    for k in range(frames + 1):
        begin = time.perf_counter()
        mask = step(k % len(references))
        times.append(time.perf_counter() - begin)
        wrong = max(wrong, int((mask != references[k % len(references)]).sum()))
        if times[0] > _BUDGET or sum(times[1:]) > _BUDGET:
            break
    kept = times if len(times) == 1 else times[1:]
    return Timing(1e3 * float(np.median(kept)), len(kept), wrong)


class Measurement:
    """One view: the rays, the references of all its frames, and rows of figures.

    Raises:
        SystemExit: a mask of ours is wrong.
    """

    def __init__(self, view: View, frames: int) -> None:
        self.view, self.frames = view, frames
        self.rays = Rays(view)
        bounds = Bounds(max_triangles=len(view.triangles), max_rays=view.camera.width * view.camera.height)
        self.tracer = ShadowTracer("mesh_bvh", device="cpu", bounds=bounds)
        self.tracer.scene.put("mesh", view.positions[0], view.triangles)
        self.references = [self._reference(frame) for frame in range(len(view.positions))]
        self.rows: list[dict[str, Any]] = []

    def _reference(self, frame: int) -> np.ndarray:
        """The mask of mesh_bvh, compared with brute_force on a random subset of the samples."""
        chosen = np.random.default_rng(frame).choice(
            len(self.rays.points), min(_SUBSET, len(self.rays.points)), replace=False
        )
        self.tracer.select("brute_force")
        self.tracer.scene.deform("mesh", self.view.positions[frame])
        expected = self.tracer.occluded(self.rays.points[chosen], self.view.light, bias=self.view.bias)
        self.tracer.select("mesh_bvh")
        mask = self._traced()
        if not np.array_equal(mask[chosen], expected):
            differing = int((mask[chosen] != expected).sum())
            raise Stop(f"{self.view.name}: mesh_bvh differs from brute_force in {differing} samples of frame {frame}")
        return mask

    def _traced(self) -> np.ndarray:
        self._frame = self.tracer.trace(self.rays.depth, self.view.camera, [self.view.light], bias=self.view.bias)
        hidden: np.ndarray = self._frame.state(self.view.light.name).ravel()[self.rays.valid] == State.SHADOWED
        return hidden

    def ours(self, pipeline: str, variant: str) -> None:
        """Add the row of a pipeline's variant."""
        self.tracer.select(pipeline, variant)
        self.tracer.warm_up()
        stages: list[dict[str, float]] = []

        def dynamic(frame: int) -> np.ndarray:
            self.tracer.scene.deform("mesh", self.view.positions[frame])
            mask = self._traced()
            stages.append(self._frame.stages)
            return mask

        moving = timed(dynamic, self.references, self.frames)
        counters = self._frame.counters
        last = (moving.frames - 1 + (len(stages) > moving.frames)) % len(self.references)
        still = None
        if moving.milliseconds < 1e3 * _TOO_LONG:
            still = timed(lambda _: self._traced(), [self.references[last]], self.frames)
        for timing in (moving, still):
            if timing is not None and timing.wrong:
                raise Stop(f"{self.view.name}: {pipeline}/{variant} is wrong in {timing.wrong} pixels")
        kept = stages[-moving.frames :]
        medians = {name: float(np.median([s.get(name, 0.0) for s in kept])) for name in kept[-1]}
        self._row(f"{pipeline}/{variant}", moving, still, {name: counters.get(name) for name in _COUNTERS}, medians)

    def peer(self, kind: type[Embree] | type[WarpMesh], query: str) -> None:
        """Add the rows of a peer."""
        rival = kind(self.view, self.rays)
        for way in kind.dynamic_ways:
            moving = timed(partial(rival.dynamic, way), self.references, self.frames)
            rival.dynamic(way, 0)
            still = timed(lambda _: rival.static(), [self.references[0]], self.frames)
            self._row(f"{kind.name} {way} + {query}", moving, still, dict.fromkeys(_COUNTERS), {})

    def _row(
        self,
        method: str,
        moving: Timing,
        still: Timing | None,
        counters: dict[str, int | None],
        stages: dict[str, float],
    ) -> None:
        self.rows.append(
            {
                "view": self.view.name,
                "triangles": len(self.view.triangles),
                "rays": len(self.rays.points),
                "in shadow": float(self.references[0].mean()),
                "method": method,
                "dynamic ms": moving.milliseconds,
                "static ms": still.milliseconds if still else None,
                "ratio": None,
                "frames": moving.frames,
                "pixels different": max(moving.wrong, still.wrong if still else 0),
                **counters,
                "stages": stages,
            }
        )

    def finish(self) -> list[dict[str, Any]]:
        """Fill in the ratios; returns the rows, best first."""
        best = min((row["dynamic ms"] for row in self.rows if "build" in row["method"].split()), default=None)
        for row in self.rows:
            if "/" in row["method"] and best is not None:
                row["ratio"] = best / row["dynamic ms"]
        self.rows.sort(key=lambda row: row["dynamic ms"])
        return self.rows


def show(rows: list[dict[str, Any]]) -> None:
    """Print the rows of one view."""
    first = rows[0]
    print(
        f"{first['view']}: {first['triangles']:,} triangles, {first['rays']:,} rays, "
        f"{100 * first['in shadow']:.0f} % of them in shadow"
    )
    shown = []
    for row in rows:
        keys = ("method", "dynamic ms", "static ms", "ratio", "frames", "pixels different")
        counts = {name.replace("_", " "): compact(row[name]) for name in _COUNTERS}
        shown.append({**{key: row[key] for key in keys}, **counts})
    table(shown)
    for row in rows:
        if row["stages"]:
            parts = ", ".join(f"{name} {ms:.1f}" for name, ms in row["stages"].items())
            print(f"  {row['method']} [ms]: {parts}")
    print(flush=True)


def choose(wanted: list[str]) -> list[tuple[str, str]]:
    """(pipeline, variant) pairs of names such as ``cone_hierarchy`` and ``mesh_bvh/refit``.

    Raises:
        SystemExit: an unknown name.
    """
    known = [(name, variant) for name, variants in available_pipelines().items() for variant in variants]
    pairs = []
    for name in wanted:
        found = [pair for pair in known if name in (pair[0], "/".join(pair))]
        if not found:
            raise SystemExit(f"--pipelines: expected names among {', '.join('/'.join(p) for p in known)}, got {name!r}")
        pairs += found
    return pairs


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height [px]")
    parser.add_argument("--frames", type=int, default=7, help="frames per figure; fewer for what takes long")
    parser.add_argument("--views", nargs="+", metavar="VIEW", help=f"all, or some of: {', '.join(names())}")
    parser.add_argument(
        "--pipelines", nargs="+", metavar="NAME", help="pipelines, or pipeline/variant; default: all but brute_force"
    )
    parser.add_argument("--threads", type=int, default=1, help="cores for everybody, ours and the peers'")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    options.views = names() if options.views == ["all"] else options.views or list(STANDARD)
    for name in options.views:
        if name not in names():
            parser.error(f"--views: expected all or some of {', '.join(names())}, got {name!r}")
    options.pipelines = choose(options.pipelines or [name for name in available_pipelines() if name != "brute_force"])
    return options


def main() -> None:
    """Measure and print."""
    options = arguments()
    confined = threads(options.threads)
    title = f"Shadow rays of one light, {options.size} x {options.size}, {options.threads} thread(s) for everybody"
    header(title)
    print(confined + "\n")
    rows: list[dict[str, Any]] = []
    for view in views(options.size, options.views):
        measurement = Measurement(view, options.frames)
        measurement.peer(Embree, "occluded")
        measurement.peer(WarpMesh, "any-hit")
        for pipeline, variant in options.pipelines:
            measurement.ours(pipeline, variant)
        rows += measurement.finish()
        show(measurement.rows)
        write_json(title, rows, options.json)  # after each view: a long run that is stopped leaves what it has


if __name__ == "__main__":
    main()
