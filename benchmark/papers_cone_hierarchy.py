# SPDX-License-Identifier: Apache-2.0
"""The experiments of "Improved Ray Hierarchy Alias Free Shadows" (the paper of ``cone_hierarchy``) again: figures 6 and
7, nodes and milliseconds per frame in the BART robots scene, and Table 2, nodes and milliseconds in four views of a
museum.

Robots: six frames of the animation, 20 to 243, each seen by the camera of the animation, and one straight at a wall, as
the paper tells of a frame that is not among these. The light is that of the scene, 500 up, and the two triangles of the
roof under it, which put everything in shadow, are left out. Without the data folder the robots of ``procedural.py``
walk.

Museum: that of ``procedural.py``, which has as many triangles as the paper's; and, where there are data, the BART
museum with fewer triangles in its sculpture, four frames with the camera of each, lit by the first light of the scene.

Like the paper, triangles that face the light are left out (``--two-sided`` keeps them). How times are taken and masks
compared: ``papers.py``.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import procedural
from papers import Bench, Measured, Still, axes_style, hidden, load, photograph, plotting, readable, save
from report import compact, header, table, threads, write_json

from shadow_tracer import Camera, PointLight, State

# The paper's Table 1, and our default beside it.
_FIGURE_6 = ("spheres", "precise", "spheres_sorted", "precise_sorted")
_FIGURE_7 = ("precise_sorted", "precise_sea", "precise_eatp", "precise_seatp")
_VARIANTS = (*_FIGURE_6, *_FIGURE_7[1:], "linear")
_TABLE_2 = (*_FIGURE_6, "linear")
# Millions of nodes in the paper's Table 2, its four views from left to right.
_PAPER_NODES = {
    "spheres": (19.89, 317.91, 6.79, 2199.22),
    "spheres_sorted": (2.66, 5.77, 5.40, 6.60),
    "precise": (17.58, 292.84, 2.24, 2163.30),
    "precise_sorted": (0.82, 2.25, 2.20, 1.97),
}
_EXPERIMENTS = ("figures 6 and 7", "table 2", "table 2, BART museum5")
_COLORS = {
    "spheres": "tab:red",
    "precise": "tab:orange",
    "spheres_sorted": "tab:purple",
    "precise_sorted": "tab:blue",
    "precise_sea": "tab:green",
    "precise_eatp": "tab:brown",
    "precise_seatp": "tab:olive",
    "linear": "black",
}

_ROOF = (230.0, 231.0)  # between these heights lie the corners of the robots' roof and no others
# Ours: eye and direction, the width of the image plane at distance 1, which of the frames it is in.
_WALL, _WALL_WIDTH, _WALL_FRAME = ((5.0, 30.0, -195.0), (1.0, 0.0, 0.0)), 1.1, 3
_MUSEUM = (("centre", "corner"), ("centre", "inside"), ("wallview", "inside"), ("room", "inside"))


def _animated(data: dict[str, np.ndarray], k: int, size: int) -> Camera:
    """The camera of a frame of an animation, with square images as the paper's."""
    focal, middle = 0.5 * size / np.tan(0.5 * np.radians(float(data["fov_y_degrees"]))), 0.5 * size - 0.5
    return Camera(size, size, focal, focal, middle, middle, data["camera"][k])


def _stills(name: str, data: dict[str, np.ndarray], labels: list[str], triangles: np.ndarray, size: int) -> list[Still]:
    light = PointLight(f"light of the {name}", data["lights"][0])
    stills = []
    for k, label in enumerate(labels):
        positions, camera = data["vertices_t"][k].astype(np.float64), _animated(data, k, size)
        depth = photograph(positions, triangles, camera)
        stills.append(Still(f"{name} {label}", positions, triangles, camera, depth, light, 0.01))
    return stills


def bart(size: int) -> list[Still]:
    """The frames of the data folder; none without it."""
    data = load("bart_robots_frames")
    if data is None:
        return []
    heights = data["vertices"][data["triangles"]][..., 1]
    roof = ((heights > _ROOF[0]) & (heights < _ROOF[1])).all(axis=1)
    print(f"BART robots: {len(roof) - roof.sum():,} triangles, {roof.sum()} of the roof left out")
    stills = _stills("frame", data, [str(frame) for frame in data["frames"]], data["triangles"][~roof], size)
    from_here = stills[_WALL_FRAME]
    pose = procedural.look_at(_WALL[0], np.add(*_WALL), (0.0, 1.0, 0.0))
    middle = 0.5 * size - 0.5
    camera = Camera(size, size, size / _WALL_WIDTH, size / _WALL_WIDTH, middle, middle, pose)
    depth = photograph(from_here.vertices, from_here.triangles, camera)
    return [*stills, replace(from_here, name="a wall", camera=camera, depth=depth)]


def bart_museum(size: int) -> list[Still]:
    """The same of the museum."""
    data = load("bart_museum5")
    if data is None:
        return []
    return _stills("museum5", data, [f"{time:g} s" for time in data["times"]], data["triangles"], size)


def walkers(size: int, triangles: int) -> list[Still]:
    """Five frames of the procedural robots, in three views."""
    made = procedural.robots(triangles, 5)
    print(f"procedural robots: {len(made.triangles):,} triangles")
    stills = []
    for name in ("grazing", "corridor", "wall"):
        camera = made.eyes[name].camera(size)
        for k, positions in enumerate(made.positions):
            depth = photograph(positions, made.triangles, camera)
            light = made.lights["outside"]
            stills.append(Still(f"{name} {k}", positions, made.triangles, camera, depth, light, 0.01))
    return stills


def museum(size: int, triangles: int) -> list[Still]:
    """Four views of a museum."""
    made = procedural.museum(triangles, 1)
    stills = []
    for eye, name in _MUSEUM:
        camera = made.eyes[eye].camera(size)
        depth = photograph(made.positions[0], made.triangles, camera, made.eyes[eye].pixels(size))
        stills.append(
            Still(f"{eye}, {name}", made.positions[0], made.triangles, camera, depth, made.lights[name], 0.01)
        )
    return stills


def measure(bench: Bench, stills: list[Still], variants: tuple[str, ...], frames: int) -> list[dict[str, Any]]:
    """A row for every still and variant."""
    rows = []
    for variant in variants:
        bench.tracer.select("cone_hierarchy", variant)
        bench.tracer.warm_up()
        for still in stills:
            rows.append(_row(still, variant, bench.measure(still, frames), hidden(bench.mask(still))))
        last = [row for row in rows if row["variant"] == variant]
        nodes, times = ([row[key] for row in last] for key in ("nodes", "ms"))
        print(f"  {variant:15} nodes {compact(min(nodes)):>6} to {compact(max(nodes)):>6}, ", end="")
        print(f"{min(times):8.1f} to {max(times):8.1f} ms", flush=True)
    return rows


def _row(still: Still, variant: str, found: Measured, in_shadow: float) -> dict[str, Any]:
    counters = found.counters
    return {
        "still": still.name,
        "variant": variant,
        "rays": counters["rays"],
        "triangles": counters["triangles"],
        "culled": counters["culled"],
        "in shadow": in_shadow,
        "nodes": counters["nodes_visited"],
        # Each triangle that casts anything is tested with the root.
        "below the root": counters["nodes_visited"]
        - counters["triangles"]
        + counters["culled"]
        + counters["degenerate"],
        "leaf tests": counters["leaf_tests"],
        "accepted": counters["accepted"],
        "ms": found.milliseconds,
        "sort": found.share("sort"),
        "frames": found.frames,
    }


def _show(rows: list[dict[str, Any]], stills: list[Still], key: str, text: Any) -> None:
    """A line for each variant, a column for each still."""
    variants = list(dict.fromkeys(row["variant"] for row in rows))
    values = {(row["variant"], row["still"]): row[key] for row in rows}
    table([{key: name, **{still.name: text(values[name, still.name]) for still in stills}} for name in variants])
    print(flush=True)


def draw(rows: list[dict[str, Any]], bench: Bench, stills: list[Still], path: Path) -> None:
    """Figures 6 and 7: nodes and milliseconds per frame, and what some of the frames look like."""
    pyplot = plotting()

    figure = pyplot.figure(figsize=(10.5, 9.0), layout="constrained")
    places = figure.add_gridspec(3, 6, height_ratios=(1.0, 1.0, 0.62))
    names = [still.name for still in stills]
    for line, (chosen, number) in enumerate(((_FIGURE_6, "as figure 6"), (_FIGURE_7, "as figure 7"))):
        for column, (key, label) in enumerate((("nodes", "nodes visited"), ("ms", "ms per frame"))):
            axes = figure.add_subplot(places[line, 3 * column : 3 * column + 3])
            for variant in (*chosen, "linear"):
                values = [row[key] for row in rows if row["variant"] == variant]
                axes.plot(range(len(values)), values, marker=".", color=_COLORS[variant], label=variant, linewidth=1.2)
            for edge in np.flatnonzero([a.split()[0] != b.split()[0] for a, b in zip(names, names[1:], strict=False)]):
                axes.axvline(edge + 0.5, color="gray", linewidth=0.6)
            axes.set_yscale("log", nonpositive="mask")
            axes.set_xticks(range(len(names)), names, rotation=60, ha="right")
            if key == "ms":
                readable(axes)
            axes_style(axes, f"{label} ({number})", "", label)
            if column == 0:
                axes.set_ylim(top=8.0 * axes.get_ylim()[1])
                axes.legend(fontsize=7, ncols=3, loc="upper right")
    chosen_stills = [stills[k] for k in np.linspace(0, len(stills) - 1, 6).round().astype(int)]
    for k, still in enumerate(chosen_stills):
        axes = figure.add_subplot(places[2, k])
        axes.imshow(_thumbnail(still, bench.mask(still)), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        axes.set_title(still.name, fontsize=8)
        axes.set_xticks([])
        axes.set_yticks([])
    save(figure, path)


def _thumbnail(still: Still, states: np.ndarray) -> np.ndarray:
    """Slopes of the depth image, dark where the light does not reach."""
    step = max(1, still.depth.shape[0] // 128)
    depth, state = still.depth[::step, ::step], states[::step, ::step]
    inverse = np.nan_to_num(1.0 / depth)
    down, right = np.gradient(inverse / max(float(inverse.max()), 1e-9) * depth.shape[0])
    shade = 0.75 / (1.0 + 0.6 * np.abs(right)) + 0.25 / (1.0 + np.abs(down))
    return np.where(state == State.LIT, shade, 0.35 * shade) * (state != State.INVALID)


def draw_museums(museums: dict[str, list[dict[str, Any]]], size: int, path: Path) -> None:
    """Table 2: nodes in the paper's four views, and in ours."""
    pyplot = plotting()

    figure, panels = pyplot.subplots(
        1, 1 + len(museums), figsize=(5.0 * (1 + len(museums)), 3.6), sharey=True, layout="constrained"
    )
    shown = {"the paper's Table 2, 1024 x 1024": (_PAPER_NODES, [f"view {k + 1}" for k in range(4)])}
    for name, rows in museums.items():
        nodes = {v: tuple(row["nodes"] / 1e6 for row in rows if row["variant"] == v) for v in _FIGURE_6}
        shown[f"here, {name}, {size} x {size}"] = nodes, list(dict.fromkeys(row["still"] for row in rows))
    for axes, (title, (values, labels)) in zip(panels, shown.items(), strict=True):
        for k, variant in enumerate(_FIGURE_6):
            places = np.arange(4) + 0.2 * (k - 1.5)
            axes.bar(places, values[variant], 0.2, color=_COLORS[variant], label=variant)
        axes.set_yscale("log")
        axes.set_xticks(range(4), labels)
        axes_style(axes, title, "", "million nodes" if values is _PAPER_NODES else "")
    panels[0].legend(fontsize=7)
    save(figure, path)


def _experiments(options: argparse.Namespace) -> list[tuple[str, list[Still], tuple[str, ...]]]:
    """What is asked for and there: name, stills, variants."""
    figures, procedural_museum, museum5 = (name in options.experiments for name in _EXPERIMENTS)
    robots = bart(options.size) if figures and not options.procedural else []
    if figures and not robots:
        robots = walkers(options.size, options.triangles)
    made = museum(options.museum_size, options.triangles) if procedural_museum else []
    real = bart_museum(options.museum_size) if museum5 and not options.procedural else []
    variants = (_VARIANTS, _TABLE_2, _TABLE_2)
    return list(zip(_EXPERIMENTS, (robots, made, real), variants, strict=True))


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--size", type=int, default=512, help="image width and height, figures 6 and 7; the paper: 1024"
    )
    parser.add_argument("--museum-size", type=int, default=256, help="the same for Table 2")
    parser.add_argument("--triangles", type=int, default=75_000, help="of procedural scenes")
    parser.add_argument("--frames", type=int, default=3, help="frames per figure; fewer for what takes long")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--two-sided", action="store_true", help="triangles that face the light cast shadows, too")
    parser.add_argument("--experiments", nargs="+", default=list(_EXPERIMENTS), choices=_EXPERIMENTS)
    parser.add_argument("--procedural", action="store_true", help="the procedural robots even where there are data")
    parser.add_argument("--out", type=Path, help="folder for the pictures; none are drawn without it")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    title = "Cone hierarchy: the paper's figures 6 and 7, and Table 2"
    header(title)
    print(threads(1) + "\n")
    experiments = _experiments(options)
    rows = {}
    for name, stills, variants in experiments:
        if not stills:
            continue
        print(f"\n{name}: {len(stills[0].triangles):,} triangles, {stills[0].camera.width} x {stills[0].camera.height}")
        bench = Bench(stills, options.device, not options.two_sided)
        rows[name] = measure(bench, stills, variants, options.frames)
        _show(rows[name], stills, "nodes", compact)
        _show([row for row in rows[name] if row["variant"] in _FIGURE_6], stills, "below the root", compact)
        _show(rows[name], stills, "ms", lambda ms: f"{ms:.1f}")
        _show([row for row in rows[name] if row["sort"] > 0], stills, "sort", lambda part: f"{100 * part:.0f} %")
        if options.out and name == _EXPERIMENTS[0]:
            draw(rows[name], bench, stills, options.out / "papers_cone_figures_6_and_7.png")
        everything = [{"experiment": key, **row} for key, found in rows.items() for row in found]
        write_json(title, everything, options.json)
    if options.out and len(rows) > (_EXPERIMENTS[0] in rows):
        museums = {"procedural" if key == "table 2" else "BART": rows[key] for key in rows if key.startswith("table 2")}
        draw_museums(museums, options.museum_size, options.out / "papers_cone_table_2.png")


if __name__ == "__main__":
    main()
