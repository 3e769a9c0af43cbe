# SPDX-License-Identifier: Apache-2.0
"""The experiments of "Performance Evaluation of Acceleration Structures for Cone-Tracing Traversal" (Wiche and Kuri
2020) again: Tables 1 and 2, nodes, triangles and time of 4, 16 and 64 rays a pixel and of cones of 0.04 to 5 degrees;
figure 7, these against the angle; and figure 8, the accelerator in a cone, with what cures it.

As in the paper, traversals are whole: nothing ends them early, no triangle is tested, lists have no end. Nodes are
those taken off the stack, triangles those in the leaves. Three views of each model, square images 60 degrees wide, so
that at the paper's 1024 x 1024 a cone of 0.04 degrees covers a pixel. Times are processor time of one thread, medians;
they are only good for ratios, and counts are exact. What is checked before a time is given: ``papers_cones_trees.py``.

Figure 8: the model is moved away from the camera, whose cones stay what they are. Whole traversals, the eight nearest
triangles (``cone_hits``), certain outcomes (``cones``), and these with a budget; an outcome with a budget is the one
without, or PARTLY.

Without the data folder the teapot of ``procedural.py`` stands for objects, its museum for rooms.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import procedural
from papers import axes_style, load, plotting, readable, save
from papers_cones_paper import PAPER, Row
from papers_cones_trees import TREES, Spent, Trees
from report import compact, header, table, threads, write_json

from shadow_tracer import Outcome

_RAYS = (4, 16, 64)
_ANGLES = (0.04, 0.5, 1.5, 2.5, 5.0)
_SPARSE = 2.0  # degrees: of wider cones about a thousand of a view are traced
_WIDTH = 2.0 * np.tan(np.radians(30.0))  # of the image at distance 1
_BUDGET = 200
_Place = tuple[float, float, float]
# Eyes and what they look at.
_VIEWS: dict[str, tuple[str, tuple[tuple[_Place, _Place], ...]]] = {
    "teapot": (
        "utah_teapot",
        (((0, 4, 9), (0, 1.5, 0)), ((7, 3, 4), (0, 1.5, 0)), ((-5, 6, -5), (0, 1.5, 0))),
    ),
    "bunny": (
        "stanford_bunny",
        (
            ((0, 0.15, 0.35), (-0.02, 0.11, 0)),
            ((0.3, 0.2, 0.1), (-0.02, 0.11, 0)),
            ((-0.25, 0.25, -0.2), (-0.02, 0.11, 0)),
        ),
    ),
    "dragon": (
        "stanford_dragon_res2",
        (((0, 0.2, 0.35), (0, 0.12, 0)), ((0.3, 0.2, 0.1), (0, 0.12, 0)), ((-0.2, 0.3, -0.2), (0, 0.12, 0))),
    ),
    "Sibenik": (
        "sibenik",
        (((-16, -13, 0), (0, -12, 0)), ((0, -10, 0), (10, -8, 0)), ((14, -11, 2), (-5, -9, 0))),
    ),
    "Sponza": (
        "sponza_dabrovic",
        (((-12, 3, 0), (5, 4, 0)), ((0, 8, 0), (10, 3, 0)), ((10, 2, 2), (-5, 4, -2))),
    ),
    "conference": (
        "conference",
        (
            ((1000, 450, 400), (200, 100, -300)),
            ((300, 300, -200), (-500, 100, -200)),
            ((-800, 400, 300), (500, 200, -300)),
        ),
    ),
}


@dataclass(frozen=True)
class Model:
    """A mesh and poses (4, 4) of cameras."""

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    poses: list[np.ndarray]


def models(names: list[str], only_procedural: bool, triangles: int) -> list[Model]:
    """Those there are data for; two made by code without any."""
    found = []
    for name in [] if only_procedural else names:
        file, places = _VIEWS[name]
        data = load(file)
        if data is not None:
            poses = [procedural.look_at(eye, target, (0.0, 1.0, 0.0)) for eye, target in places]
            found.append(Model(name, data["vertices"].astype(np.float64), data["triangles"], poses))
    if found:
        return found
    made = [("procedural teapot", procedural.stadium(triangles)), ("procedural museum", procedural.museum(triangles))]
    return [
        Model(name, scene.positions[0], scene.triangles, [eye.camera(2).camera_to_world for eye in scene.eyes.values()])
        for name, scene in made
    ]


def directions(pose: np.ndarray, size: int, per_pixel: int) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) apices and directions of ``per_pixel`` rays in each pixel, a square number, on a grid."""
    count = size * int(np.sqrt(per_pixel))
    at = ((np.arange(count) + 0.5) / count - 0.5) * _WIDTH
    ways = np.stack([*np.meshgrid(at, at), np.ones((count, count))], axis=-1).reshape(-1, 3) @ pose[:3, :3].T
    return np.broadcast_to(pose[:3, 3], ways.shape), ways / np.linalg.norm(ways, axis=1)[:, None]


def _mean(parts: list[Spent], factor: int = 1) -> dict[str, Any]:
    return {
        "us": factor * float(np.mean([part.microseconds for part in parts])),
        "nodes": factor * float(np.mean([part.nodes for part in parts])),
        "triangles": factor * float(np.mean([part.triangles for part in parts])),
    }


def tables(model: Model, trees: Trees, size: int, turns: int) -> list[dict[str, Any]]:
    """Rows of Table 1 or 2: of each tree, so many rays a pixel and cones of each angle."""
    rows: list[dict[str, Any]] = []
    for tree in TREES:
        shared = {"model": model.name, "triangles of it": len(model.triangles), "tree": tree}
        shared["build ms"] = trees.build_ms[tree.split(",")[0]]
        per_ray = 0.0
        for number in _RAYS:
            sets = [directions(pose, size, number) for pose in model.poses]
            parts = [trees.traverse(tree, *rays, 0.0, turns) for rays in sets]
            rows.append({**shared, "rays": number, "degrees": None, **_mean(parts, number)})
            per_ray = rows[-1]["us"] / number
        for angle in _ANGLES:
            every = max(1, size * size // 1000) if angle > _SPARSE else 1
            sets = [tuple(part[::every] for part in directions(pose, size, 1)) for pose in model.poses]
            slope = float(np.tan(np.radians(angle)))
            parts = [trees.traverse(tree, *cones, slope, turns) for cones in sets]
            rows.append({**shared, "rays": None, "degrees": angle, **_mean(parts)})
            rows[-1]["in rays"] = rows[-1]["us"] / per_ray
    return rows


def show_tables(rows: list[dict[str, Any]]) -> None:
    """Print them, a line for each tree and the paper's beside it: microseconds / nodes / triangles (rays that take as
    long); of the paper milliseconds of the frame instead."""
    lines = []
    for model in dict.fromkeys(row["model"] for row in rows):
        own = [row for row in rows if row["model"] == model]
        for tree in dict.fromkeys(row["tree"] for row in own):
            line = {"model": model, "tree": tree}
            for row in (row for row in own if row["tree"] == tree):
                text = f"{row['us']:.2g} / {compact_mean(row['nodes'])} / {compact_mean(row['triangles'])}"
                line[_label(row)] = text + (f" ({row['in rays']:.0f})" if row["degrees"] else "")
            lines.append(line)
        for tree, theirs in PAPER.get(model, {}).items():
            lines.append({"model": model, "tree": f"{tree}, paper", **_of_the_paper(theirs)})
    keys = list(max(lines, key=len))
    table([{key: line.get(key) for key in keys} for line in lines])
    print(flush=True)


def compact_mean(value: float) -> str:
    """A mean count: 3.4, 57, 13.2k."""
    return f"{value:.1f}" if value < 10.0 else compact(round(value))


def _label(row: dict[str, Any]) -> str:
    return f"{row['rays']} rays" if row["rays"] else f"{row['degrees']:g} deg"


def _of_the_paper(theirs: tuple[Row | None, ...]) -> dict[str, str | None]:
    labels = [f"{number} rays" for number in _RAYS] + [f"{angle:g} deg" for angle in _ANGLES]
    most = theirs[2]
    found: dict[str, str | None] = {}
    for label, row in zip(labels, theirs, strict=True):
        found[label] = None
        if row is not None and most is not None:
            found[label] = f"{row[0]:g} ms / {row[1]:g} / {row[2]:g}"
            found[label] += f" ({64 * row[0] / most[0]:.0f})" if label.endswith("deg") else ""
    return found


def accelerator_in_a_cone(model: Model, size: int, angle: float, turns: int) -> list[dict[str, Any]]:
    """Rows of figure 8: the model at so many times its distance."""
    rows = []
    trees = Trees(model.vertices, model.triangles)
    pose, slope = model.poses[0], float(np.tan(np.radians(angle)))
    middle = 0.5 * (model.vertices.min(axis=0) + model.vertices.max(axis=0))
    for times in (1, 4, 16, 64):
        away = pose.copy()
        away[:3, 3] = middle + times * (pose[:3, 3] - middle)
        apices, ways = directions(away, size, 1)
        whole = trees.traverse("bvh, 2 children", apices, ways, slope, turns)
        # To behind the model: outcomes need an end.
        length = float(np.linalg.norm(away[:3, 3] - middle) + np.ptp(model.vertices, axis=0).max())
        hits, outcomes, few = _questions(trees, apices, ways, np.radians(angle), length, turns)
        met = outcomes.found != Outcome.FREE
        rows.append(
            {
                "model": model.name,
                "times as far": times,
                "cones that meet it": float(met.mean()),
                "nodes": whole.nodes,
                "triangles": whole.triangles,
                "most triangles of a cone": whole.most,
                "us": whole.microseconds,
                "us, 8 nearest": hits.microseconds,
                "us, outcome": outcomes.microseconds,
                f"us, budget {_BUDGET}": few.microseconds,
                f"PARTLY, budget {_BUDGET}": float((few.found == Outcome.PARTLY).mean()),
                "PARTLY": float((outcomes.found == Outcome.PARTLY).mean()),
            }
        )
    return rows


@dataclass(frozen=True)
class _Asked:
    microseconds: float
    found: Any


def _questions(
    trees: Trees, apices: np.ndarray, ways: np.ndarray, angle: float, length: float, turns: int
) -> tuple[_Asked, _Asked, _Asked]:
    tracer, ends = trees.tracer, apices + length * ways

    def asked(call: Callable[[], Any]) -> _Asked:
        spent = []
        for _ in range(turns + 1):  # the first loads kernels
            begin = time.process_time()
            found = call()
            spent.append(time.process_time() - begin)
        return _Asked(1e6 * float(np.median(spent[1:])) / len(apices), found)

    hits = asked(lambda: tracer.cone_hits(apices, ways, angle, 8))
    outcomes = asked(lambda: tracer.cones(apices, ends, half_angle=angle))
    few = asked(lambda: tracer.cones(apices, ends, half_angle=angle, budget=_BUDGET))
    lists = hits.found[0][:, 0]
    if ((lists >= 0) & (hits.found[1][:, 0] < length) & (outcomes.found == Outcome.FREE)).any():
        raise SystemExit("a cone is FREE, and has a triangle in its list")
    if ((few.found != outcomes.found) & (few.found != Outcome.PARTLY)).any():
        raise SystemExit("a budget has changed an outcome to another one than PARTLY")
    return hits, outcomes, few


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Figure 7: microseconds and nodes against the angle, of an object and a room; dotted: rays."""
    pyplot = plotting()

    names = list(dict.fromkeys(row["model"] for row in rows))
    chosen = [name for name in ("teapot", "Sibenik") if name in names] or names[:2]
    figure, places = pyplot.subplots(
        2, len(chosen), figsize=(4.8 * len(chosen), 6.0), layout="constrained", squeeze=False
    )
    for column, name in enumerate(chosen):
        for line, (key, label) in enumerate((("us", "us"), ("nodes", "nodes"))):
            axes = places[line][column]
            for tree, color in zip(TREES, ("tab:blue", "tab:cyan", "tab:red"), strict=True):
                own = [row for row in rows if row["model"] == name and row["tree"] == tree]
                cones = [(row["degrees"], row[key]) for row in own if row["degrees"]]
                if cones:
                    axes.plot(*zip(*cones, strict=True), marker=".", color=color, label=f"{tree}, cone")
                for row in own:
                    if row["rays"]:
                        label_of = f"{tree}, rays" if row["rays"] == _RAYS[0] else None
                        axes.axhline(row[key], color=color, linestyle=":", linewidth=0.9, label=label_of)
            axes.set_xscale("log")
            axes.set_yscale("log")
            readable(axes)
            axes_style(axes, f"{name}: {label} a pixel (rays: 4, 16, 64)", "half angle [degrees]", label)
            axes.legend(fontsize=6)
    save(figure, path)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=128, help="image width and height; the paper: 1024")
    parser.add_argument("--models", nargs="+", default=list(_VIEWS), choices=list(_VIEWS), metavar="MODEL")
    parser.add_argument("--triangles", type=int, default=70_000, help="of procedural scenes")
    parser.add_argument("--turns", type=int, default=3, help="of which the median time is given")
    parser.add_argument("--procedural", action="store_true", help="procedural scenes only, even where there are data")
    parser.add_argument("--out", type=Path, help="folder for the picture; none is drawn without it")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    title = f"Cones through trees: the paper's Tables 1 and 2, figures 7 and 8, {options.size} x {options.size}"
    header(title)
    print(threads(1) + "\n")
    found = models(options.models, options.procedural, options.triangles)
    everything: list[dict[str, Any]] = []
    for model in found:
        rows = tables(model, Trees(model.vertices, model.triangles), options.size, options.turns)
        show_tables(rows)
        everything += [{"experiment": "tables", **row} for row in rows]
        write_json(title, everything, options.json)
    if options.out:
        draw([row for row in everything if row["experiment"] == "tables"], options.out / "papers_cones_figure_7.png")
    for model in [model for model in found if model.name in ("dragon", "bunny")] or found[:1]:
        rows = accelerator_in_a_cone(model, options.size, 0.5, options.turns)
        print(f"\nFigure 8: {model.name}, half angle 0.5 degrees, {options.size} x {options.size} cones")
        table(rows)
        everything += [{"experiment": "figure 8", **row} for row in rows]
        write_json(title, everything, options.json)


if __name__ == "__main__":
    main()
