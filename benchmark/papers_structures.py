# SPDX-License-Identifier: Apache-2.0
"""The structures of the lecture "Ray Tracing II" (Lensch 2007) side by side: brute force, grids, trees of space, trees
of boxes, directions around the light, rays by origin and direction, and what holds rays instead of triangles.

Of each structure and view: what it takes to make for a new mesh and to make or mend when vertices have moved, the
memory it reserves, steps and triangles per ray, and whole frames, the mesh moving (*dynamic*) and at rest (*static*;
in both the depth image is new). *Steps* are nodes, cells or boxes that are looked at, as the frame's counters have
them (of a structure over rays, by triangles; of ``light_grid/spherical`` entries of its lists); *triangles* are tests
of a ray and a triangle. Both are exact, and the same in every run. *Structure* is what depends on the scene (of a
structure over rays: on these), records of triangles aside.

Times are processor time of one thread, medians. No row without masks: all pixels of all timed frames are compared with
``mesh_bvh``, and that with ``brute_force`` in some; one that differs stops the program.

``--growth``: the museum with more and more triangles, to see what grows how.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from statistics import median
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
from case import Case, hidden
from report import compact, header, note, table, threads, write_json
from scenes import View, procedural_view, views

from shadow_tracer import Bounds, ShadowTracer

STRUCTURES = (
    "brute_force/filtered",
    "uniform_grid/dda",
    "hierarchical_grid/nested",
    "octree/parametric",
    "kd_tree/sah",
    "bsp/exact",
    "bvh/median",
    "bvh/lbvh",
    "bvh/threaded",
    "bvh/sah single",
    "bvh/sah",
    "mesh_bvh/refit",
    "light_buffer/cube",
    "ray_classification/lazy",
    "cone_hierarchy/linear",
    "light_grid/spherical",
    "light_grid/packed",
)
VIEWS = (
    "robots/corridor/inside",
    "museum/room/inside",
    "BART robots",
    "Sponza",
    "Sibenik",
    "conference",
    "teapot",
    "bunny",
    "dragon",
    "armadillo",
    "Cornell box",
    "hospital",
    "livingroom1",
    "redkitchen",
    "Mars",
    "Jacksboro",
    "stadium/pot/inside",
)
# The stages of a frame in which a structure is made.
_MADE_IN = ("build", "sort", "pack", "count")
_REFERENCES = 8  # memberships in cells, of a triangle, for which there is room
# Get better with more room than that, and have what is the library's default.
_TAKE_ALL = ("light_buffer/cube", "ray_classification/lazy")
# Bytes of what triangles are asked by, which every pipeline has.
_PLAIN = "brute_force/filtered"


def bounds_of(case: Case, name: str) -> Bounds:
    """What fits a case, so that memory says something about the structure."""
    triangles = len(case.view.triangles)
    rays = max(frame.valid.size for frame in case.frames)
    room = max(_REFERENCES * triangles + 64, Bounds().grid_entries if name in _TAKE_ALL else 0)
    return Bounds(max_triangles=triangles, max_rays=rays, max_lights=1, grid_entries=room)


class Structure:
    """One of ``STRUCTURES`` on a case."""

    def __init__(self, name: str, case: Case) -> None:
        self.name, self._case = name, case
        pipeline, variant = name.split(" ")[0].split("/")
        self._tracer = ShadowTracer(pipeline, variant, "cpu", bounds_of(case, name), threads=1)
        if name.endswith("single"):
            from shadow_tracer.gpu.accelerators.bvh.bvh import SINGLE

            walker: Any = self._tracer._engine.inside._bands[0].pipeline
            walker.build.walk = SINGLE
        self._tracer.warm_up()
        self.frames: dict[str, list[float]] = {}
        self.made: dict[str, list[float]] = {}
        self.counters: dict[str, int] = {}
        self._turn = 0

    @property
    def bytes(self) -> int:
        """Reserved on the device, by everything."""
        return int(self._tracer.device_bytes)

    def turn(self) -> float:
        """A new mesh, one that has moved, one at rest; seconds of all."""
        view, scene = self._case.view, self._tracer.scene
        begin = time.process_time()
        self._turn += 1
        # Other triangles at the same places: another topology, and no other answer.
        scene.put("mesh", view.positions[1], np.roll(view.triangles, self._turn, axis=0))
        self._trace("new", 1, self._case.dynamic[1], time.process_time())
        moved = time.process_time()
        scene.deform("mesh", view.positions[0])
        self._trace("dynamic", 0, self._case.dynamic[0], moved)
        self._trace("static", 2, self._case.static[2], time.process_time())
        return time.process_time() - begin

    def _trace(self, what: str, frame: int, right: np.ndarray, begin: float) -> None:
        shot, lights = self._case.frames[frame].shot, self._case.lights
        # Stages read the clock of the processor as well.
        clock = SimpleNamespace(perf_counter=time.process_time)
        with mock.patch("shadow_tracer.gpu.device.stages.time", clock):
            found = self._tracer.trace(shot.depth, shot.camera, lights, bias=self._case.view.bias)
        self.frames.setdefault(what, []).append(1e3 * (time.process_time() - begin))
        wrong = int((hidden(found, lights, self._case.frames[frame]) != right).sum())
        if wrong:
            raise SystemExit(f"{self._case.view.name}: {self.name} differs from mesh_bvh in {wrong} rays")
        self.made.setdefault(what, []).append(sum(found.stages.get(stage, 0.0) for stage in _MADE_IN))
        self.counters = dict(found.counters)

    def row(self, plain: int) -> dict[str, Any]:
        """What has been found; ``plain``: bytes reserved without any structure."""
        counters, rays = self.counters, max(self.counters["rays"], 1)
        steps = counters["nodes_visited"] or counters["entries"]
        return {
            "view": self._case.view.name,
            "triangles of it": len(self._case.view.triangles),
            "rays": counters["rays"],
            "in shadow": self._case.in_shadow,
            "structure": self.name,
            "new ms": median(self.made["new"]),
            "moved ms": median(self.made["dynamic"]),
            "MB": 1e-6 * (self.bytes - plain),
            "steps": steps / rays,
            "triangles": counters["leaf_tests"] / rays,
            "dynamic ms": median(self.frames["dynamic"]),
            "static ms": median(self.frames["static"]),
            "turns": len(self.frames["static"]),
        }


def measure(view: View, names: tuple[str, ...], turns: int, seconds: float, known: dict[str, float]) -> Iterator[Any]:
    """Rows of a view. No structure gets a further turn after ``seconds``; none is begun that would take five times as
    long for one, if it were as quick as it ever was. ``known``: the least seconds of a turn per triangle in the views
    before, which is brought up to date."""
    case = Case(view, 3)  # no two frames in turn have the same image
    plain = Structure(_PLAIN, case).bytes
    for name in names:
        expected = known.get(name, 0.0) * len(view.triangles)
        if expected > 5.0 * seconds:
            note(f"{view.name}: {name} is left out, a turn would take about {expected:.0f} s")
            continue
        structure, spent = Structure(name, case), [0.0]
        while len(spent) <= turns and sum(spent) < seconds:
            spent.append(structure.turn())
        known[name] = min(known.get(name, np.inf), max(spent) / len(view.triangles))
        yield structure.row(plain)


def show(rows: list[dict[str, Any]]) -> None:
    """A table of a view's rows."""
    first = rows[0]
    print(f"\n{first['view']}: {first['triangles of it']:,} triangles, {first['rays']:,} rays, ", end="")
    print(f"{100 * first['in shadow']:.0f} % in shadow\n")
    keys = ("structure", "new ms", "moved ms", "MB", "steps", "triangles", "dynamic ms", "static ms", "turns")
    table([{key: _text(key, row[key]) for key in keys} for row in rows])
    print(flush=True)


def _text(key: str, value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return compact(round(value)) if value >= 1000.0 else f"{value:.3g}"


def summary(rows: list[dict[str, Any]], keys: tuple[str, ...], column: str = "view") -> None:
    """For each of ``keys`` a table with a line for each structure and a column for each view."""
    of = {(row["structure"], row[column]): row for row in rows}
    columns = list(dict.fromkeys(row[column] for row in rows))
    for key in keys:
        print(f"\n{key}\n")
        lines = []
        for name in dict.fromkeys(row["structure"] for row in rows):
            values = {str(c): of[name, c][key] if (name, c) in of else None for c in columns}
            lines.append({"structure": name, **{c: None if v is None else _text(key, v) for c, v in values.items()}})
        table(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=128, help="image width and height [px]")
    parser.add_argument("--views", nargs="+", default=list(VIEWS), metavar="VIEW")
    parser.add_argument("--structures", nargs="+", default=list(STRUCTURES), choices=STRUCTURES, metavar="NAME")
    parser.add_argument("--turns", type=int, default=5, help="of which the median is given")
    parser.add_argument("--seconds", type=float, default=4.0, help="after which a structure gets no further turn")
    parser.add_argument("--triangles", type=int, help="of procedural scenes; about 70,000 without it")
    parser.add_argument("--growth", nargs="*", type=int, metavar="TRIANGLES", help="instead: the museum with so many")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    title = f"Structures side by side, {options.size} x {options.size}"
    header(title)
    print(threads(1))
    names, known = tuple(options.structures), dict[str, float]()
    everything: list[dict[str, Any]] = []
    for view in _views(options):
        rows = list(measure(view, names, options.turns, options.seconds, known))
        show(rows)
        everything += rows
        write_json(title, everything, options.json)
    if options.growth is None:
        summary(everything, ("new ms", "moved ms", "MB", "steps", "triangles", "dynamic ms", "static ms"))
    else:
        summary(everything, ("new ms", "steps", "triangles", "static ms"), "triangles of it")


def _views(options: argparse.Namespace) -> Iterator[View]:
    if options.growth is not None:
        for count in options.growth or (1_000, 4_000, 16_000, 64_000, 256_000):
            yield procedural_view("museum", "room", "inside", options.size, count, 3)
        return
    for name in options.views:
        parts = name.split("/")
        if options.triangles and len(parts) == 3:
            yield procedural_view(parts[0], parts[1], parts[2], options.size, options.triangles, 3)
        else:
            yield from views(options.size, [name])


if __name__ == "__main__":
    main()
