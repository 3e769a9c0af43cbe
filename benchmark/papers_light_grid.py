# SPDX-License-Identifier: Apache-2.0
"""The experiments of "Ray Tracing Dynamic Scenes with Shadows on GPU" (the paper of ``light_grid``) again: rows as in
Table 1, and figure 9, time against the distance of the light for several thresholds r.

r is the most rays of a work item: tiles with more become several. It is ``SphericalGrid(threshold=r)``, 32 in the
variant ``spherical``. For figure 9 the grid has the paper's size, keys of 18 bits: 2^14 tiles of 16 depth cells.

On a CPU work items are done one after the other, so r cannot matter to the time. What it is for, that no worker of many
has much more to do than others, is counted instead: tests of every ray, the longest in each group of 32 rays (which run
in step), and how long the busiest of 240 workers has to work if each takes the next work item when it is done. That is
arithmetic on counts, not a time. With ``--device cuda:0`` the times are those of a GPU.

How times are taken and masks compared: ``papers.py``.
"""

from __future__ import annotations

import argparse
import heapq
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import papers_light_grid_table
import procedural
import warp as wp
from papers import Bench, Measured, Still, axes_style, hidden, load, photograph, plotting, save
from pictures_counts import count_spherical
from report import header, table, threads, write_json

from shadow_tracer import Camera, PointLight
from shadow_tracer.gpu.accelerators.spherical_grid import spherical

_THRESHOLDS = (32, 64, 128, 256, 512)
_UNLIMITED = 1 << 22
_TILES, _CELLS = 1 << 14, 16
_WORKERS, _LANES = 240, 32
_DISTANCES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
_TOWARDS_LIGHT = np.array([0.48, 0.8, 0.36])  # a unit vector, the second axis up


def bunny_and_dragon() -> tuple[np.ndarray, np.ndarray] | None:
    """(V, 3) vertices, y up, and (T, 3) triangles of two models side by side on a floor; None without the data folder.
    The paper's is an animation in which one breaks the other; these stand still."""
    bunny, dragon = load("stanford_bunny"), load("stanford_dragon_res2")
    if bunny is None or dragon is None:
        return None
    vertices, triangles, count = [], [], 0
    for data, shift in ((bunny, -0.09), (dragon, 0.09)):
        points = data["vertices"].astype(np.float64)
        low, high = points.min(axis=0), points.max(axis=0)
        vertices.append(points - [0.5 * (low[0] + high[0]) - shift, low[1], 0.5 * (low[2] + high[2])])
        triangles.append(data["triangles"] + count)
        count += len(points)
    floor = np.array([(-0.4, -1e-4, -0.4), (0.4, -1e-4, -0.4), (0.4, -1e-4, 0.4), (-0.4, -1e-4, 0.4)])
    faces = np.array([(0, 2, 1), (0, 3, 2)], np.int32) + count
    return np.concatenate([*vertices, floor]), np.concatenate([*triangles, faces]).astype(np.int32)


def standing(size: int, mesh: tuple[np.ndarray, np.ndarray]) -> Still:
    """The bunny and the dragon as a camera before them sees them."""
    pose = procedural.look_at((0.12, 0.22, 0.42), (0.0, 0.07, 0.0), (0.0, 1.0, 0.0))
    middle = 0.5 * size - 0.5
    camera = Camera(size, size, 1.1 * size, 1.1 * size, middle, middle, pose)
    depth = photograph(*mesh, camera)
    return Still("Bunny/Dragon", *mesh, camera, depth, PointLight("lamp", (0.2, 0.5, 0.3)), 1e-4)


def walking(size: int, triangles: int) -> Still:
    """The procedural robots, seen from above."""
    made = procedural.robots(triangles, 1)
    camera = made.eyes["disc"].camera(size)
    depth = photograph(made.positions[0], made.triangles, camera)
    return Still("procedural robots", made.positions[0], made.triangles, camera, depth, made.lights["inside"], 0.01)


def moved(still: Still, distance: float) -> Still:
    """The same with a light so many radii of what is seen from its middle."""
    points = still.camera.unproject(still.depth).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    way = _TOWARDS_LIGHT if still.camera.camera_to_world[1, 1] < -0.5 else _TOWARDS_LIGHT[[0, 2, 1]]
    where = 0.5 * (low + high) + distance * 0.5 * float(np.linalg.norm(high - low)) * way
    name = f"{still.name}, {distance:g}"
    return Still(
        name, still.vertices, still.triangles, still.camera, still.depth, PointLight("lamp", where), still.bias
    )


class Spherical:
    """Selects ``light_grid/spherical`` with other settings than its own; ``grid`` is the pipeline."""

    def __init__(self, bench: Bench, rays: int, threshold: int) -> None:
        self.grid: Any = None

        def make(variant: str, context: Any) -> Any:
            self.grid = original(variant, context, max(1, rays // _TILES), _CELLS, threshold)
            return self.grid

        original = spherical.SphericalGrid
        bench.tracer.select("light_grid", "packed")  # select() may keep what is selected already
        with mock.patch.object(spherical, "SphericalGrid", make):
            bench.tracer.select("light_grid", "spherical")
        assert self.grid is not None
        self.threshold = threshold

    def tests(self, rays: int, expected: int) -> tuple[np.ndarray, np.ndarray]:
        """(N,) tile and tests of the rays of the last frame, in the order of the tiles.

        Raises:
            SystemExit: they do not add up to ``expected``.
        """
        grid, context = self.grid, self.grid._context
        device = context.samples.device
        found = wp.zeros(rays, dtype=int, device=device)
        of, lists = grid.rays, grid.lists
        inputs = [of.tile_count, context.samples.rays, of.polar, of.keys, of.order, of.tiles]
        inputs += [lists.begins, lists.keys, lists.values, context.records.of(0), found]
        wp.launch(count_spherical, dim=rays, inputs=inputs, device=device)
        keys, order, tests = of.keys.numpy()[:rays], of.order.numpy()[:rays], found.numpy()
        there = keys != of.tile_count
        if int(tests.sum()) != expected:
            raise SystemExit(f"counted {int(tests.sum())} tests, the frame {expected}")
        return keys[there], tests[order[there]]

    def items(self) -> int:
        """Work items of the last frame."""
        return int(self.grid.rays.counts.numpy()[0])


def work_items(tiles: np.ndarray, tests: np.ndarray, threshold: int) -> np.ndarray:
    """(I,) steps of each work item: rays of a tile, at most ``threshold`` of them, ``_LANES`` at a time; what runs in
    step takes as long as the longest."""
    first = np.flatnonzero(np.diff(tiles, prepend=-1))
    rank = np.arange(len(tiles)) - np.repeat(first, np.diff(first, append=len(tiles)))
    begins = np.flatnonzero(rank % threshold == 0)
    rounds = np.flatnonzero(rank % threshold % _LANES == 0)
    longest = np.maximum.reduceat(tests, rounds)
    return np.add.reduceat(longest, np.searchsorted(rounds, begins))


def busiest(steps: np.ndarray) -> int:
    """Steps of the busiest of ``_WORKERS``, each taking the next work item when it is done."""
    workers = [0] * _WORKERS
    for step in steps.tolist():
        heapq.heapreplace(workers, workers[0] + step)
    return max(workers)


def figure_9(still: Still, device: str, frames: int) -> list[dict[str, Any]]:
    """Rows by distance and r, and by distance and variant as it is. Everything is measured twice, in two rounds, so
    that no r has a busy minute of the machine alone."""
    stills = [moved(still, distance) for distance in _DISTANCES]
    bench = Bench(stills, device, False)
    rows: dict[tuple[Any, float], dict[str, Any]] = {}
    loads: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    # On CUDA a work item has a thread for each of r rays.
    thresholds = (*_THRESHOLDS, *((_UNLIMITED,) if device == "cpu" else ()))
    for kind in 2 * (*thresholds, "packed", "spherical"):
        if isinstance(kind, str):
            way = None
            bench.tracer.select("light_grid", kind)
        else:
            way = Spherical(bench, still.depth.size, kind)
        bench.tracer.warm_up()
        for distance, at in zip(_DISTANCES, stills, strict=True):
            found = bench.measure(at, frames)
            name = kind if kind != _UNLIMITED else "unlimited"
            row = {"model": still.name, "distance": distance, "r": name, "ms": found.milliseconds}
            if (name, distance) in rows:
                row["ms"] = min(row["ms"], rows[name, distance]["ms"])
            if way is not None:
                row |= _counted(way, bench, at, found, loads)
            rows[name, distance] = row
    return list(rows.values())


def _counted(way: Spherical, bench: Bench, at: Still, found: Measured, loads: dict[str, Any]) -> dict[str, Any]:
    """What the frame that was just traced can tell but for its time. ``loads``: tiles and tests of the rays by frame,
    which do not depend on r."""
    rays, tests = found.counters["rays"], found.counters["leaf_tests"]
    if at.name not in loads:
        loads[at.name] = way.tests(at.depth.size, tests)
    steps = work_items(*loads[at.name], way.threshold)
    if len(steps) != way.items():
        raise SystemExit(f"{at.name}: counted {len(steps)} work items, the frame {way.items()}")
    most = busiest(steps)
    return {
        "in shadow": hidden(bench.mask(at)),
        "tests per ray": tests / rays,
        "entries": found.counters["entries"],
        "most rays of a tile": int(np.bincount(loads[at.name][0]).max()),
        "work items": len(steps),
        "longest item": int(steps.max()),
        "busiest": most,
        "over even": most * _WORKERS / max(int(steps.sum()), 1),
    }


def show_9(rows: list[dict[str, Any]]) -> None:
    """Print figure 9: a line for each distance."""
    kinds = list(dict.fromkeys(row["r"] for row in rows))
    for key, text in (("ms", "{:.1f}"), ("longest item", "{:,}"), ("busiest", "{:,}"), ("over even", "{:.2f}")):
        of = {(row["distance"], row["r"]): row[key] for row in rows if key in row}
        print(f"{rows[0]['model']}: {key}; columns: r")
        shown = [k for k in kinds if (_DISTANCES[0], k) in of]
        table([{"distance": d, **{str(k): text.format(of[d, k]) for k in shown}} for d in _DISTANCES])
        print()
    first = [row for row in rows if row["r"] == _THRESHOLDS[0]]
    keys = ("distance", "in shadow", "tests per ray", "entries", "most rays of a tile")
    table([{key: row[key] for key in keys} for row in first])
    print(flush=True)


def draw_9(rows: list[dict[str, Any]], device: str, path: Path) -> None:
    """Milliseconds, and steps of the busiest worker, against the distance of the light."""
    pyplot = plotting()

    models = list(dict.fromkeys(row["model"] for row in rows))
    figure, places = pyplot.subplots(
        len(models), 2, figsize=(9.5, 3.4 * len(models)), layout="constrained", squeeze=False
    )
    for line, model in zip(places, models, strict=True):
        own = [row for row in rows if row["model"] == model]
        for k, kind in enumerate(dict.fromkeys(row["r"] for row in own)):
            of = [row for row in own if row["r"] == kind]
            dashed = kind in ("packed", "spherical")
            label = f"{kind} as it is" if dashed else f"r {kind}"
            style: dict[str, Any] = {
                "marker": ".",
                "linewidth": 1.2,
                "linestyle": "--" if dashed else "-",
                "label": label,
            }
            style["color"] = "black" if kind == "packed" else "gray" if dashed else pyplot.colormaps["viridis"](k / 6)
            line[0].plot(_DISTANCES, [row["ms"] for row in of], **style)
            if not dashed:
                line[1].plot(_DISTANCES, [row["busiest"] for row in of], **style)
        x = "distance of the light from the middle [radii of what is seen]"
        where = "one CPU core" if device == "cpu" else device
        axes_style(line[0], f"{model}: frame, {where}", x, "ms")
        axes_style(line[1], f"{model}: busiest of {_WORKERS} workers (counted)", x, f"steps of {_LANES} rays")
        for axes in line:
            axes.set_xscale("log", base=2)
            axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])
            axes.legend(fontsize=7, ncols=4, loc="upper center")
    save(figure, path)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height; the paper: 1024")
    parser.add_argument("--triangles", type=int, default=70_000, help="of procedural scenes")
    parser.add_argument("--frames", type=int, default=5, help="frames per figure")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0, for figure 9")
    parser.add_argument("--procedural", action="store_true", help="procedural scenes only, even where there are data")
    parser.add_argument("--out", type=Path, help="folder for the picture; none is drawn without it")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    title = f"Light grid: the paper's Table 1 and figure 9, {options.size} x {options.size}"
    header(title)
    print(threads(1) + "\n")
    mesh = None if options.procedural else bunny_and_dragon()
    robots = walking(options.size, options.triangles)
    models = [standing(options.size, mesh), robots] if mesh else [robots]
    rows = papers_light_grid_table.measure(models, options.size, options.frames, options.procedural)
    everything = [{"experiment": "table 1", **row} for row in rows]
    write_json(title, everything, options.json)
    nines: list[dict[str, Any]] = []
    for model in models:
        found = figure_9(model, options.device, options.frames)
        show_9(found)
        nines += found
        write_json(title, everything + [{"experiment": "figure 9", **row} for row in nines], options.json)
    if options.out:
        draw_9(nines, options.device, options.out / "papers_light_distance.png")


if __name__ == "__main__":
    main()
