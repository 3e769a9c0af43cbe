# SPDX-License-Identifier: Apache-2.0
"""The experiments of "Improved Ray Hierarchy Alias Free Shadows" (the paper of ``cone_hierarchy``) again: figures 6 and
7, nodes and milliseconds per frame in the BART robots scene, and Table 2, nodes and milliseconds in four views of a
museum.

Robots: the frames of the animation that the data folder has, 10 to 12 s; at the 16 frames a second of the animation
these are frames 160 to 192 of 800. Each is seen three times: by the camera of the animation, which turns from robots to
a wall there; down the street, as the paper's frame 105 is said to look; and straight at a wall, as its frame 160. The
light is that of the scene, 500 up, and the two triangles of the roof under it, which put everything in shadow, are left
out. Without the data folder the robots of ``procedural.py`` walk.

Museum: that of ``procedural.py``, as the BART museum is not in the data folder.

Like the paper, triangles that face the light are left out (``--two-sided`` keeps them). How times are taken and masks
compared: ``papers.py``.
"""

from __future__ import annotations

import argparse
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

_FRAME_RATE = 16.0
# The camera of the animation at the times of the data folder, to a tenth: eye and direction.
_ANIMATED = (
    ((4.9, 17.2, -162.2), (-0.43, -0.21, -0.88)),
    ((6.1, 16.8, -163.8), (-0.54, -0.19, -0.82)),
    ((6.6, 16.2, -164.9), (-0.64, -0.17, -0.75)),
    ((6.0, 15.6, -164.9), (-0.73, -0.15, -0.67)),
    ((4.4, 14.5, -164.4), (-0.80, -0.13, -0.58)),
)
# Ours: eye and direction, the width of the image plane at distance 1.
_STREET = ((-7.0, 6.0, -140.0), (7.0, -3.0, -25.0)), 1.1
_WALL = ((5.0, 30.0, -195.0), (1.0, 0.0, 0.0)), 1.1
_ANIMATED_WIDTH = 0.67
_ROOF = (230.0, 231.0)  # between these heights lie the roof's corners and no others
_MUSEUM = (("centre", "corner"), ("centre", "inside"), ("wallview", "inside"), ("room", "inside"))


def bart(size: int) -> list[Still]:
    """The frames of the data folder, in three views; none without it."""
    data = load("bart_robots_t10")
    if data is None:
        return []
    heights = data["vertices"][data["triangles"]][..., 1]
    roof = ((heights > _ROOF[0]) & (heights < _ROOF[1])).all(axis=1)
    triangles = data["triangles"][~roof]
    print(f"BART robots: {len(triangles):,} triangles, {roof.sum()} of the roof left out")
    light = PointLight("scene light", data["lights"][0])
    stills = []
    for name in ("camera", "street", "wall"):
        for k, (vertices, time) in enumerate(zip(data["vertices_t"], data["times"], strict=True)):
            (eye, way), width = _STREET if name == "street" else _WALL
            if name == "camera":
                (eye, way), width = _ANIMATED[k], _ANIMATED_WIDTH
            pose = procedural.look_at(eye, np.add(eye, way), (0.0, 1.0, 0.0))
            middle = 0.5 * size - 0.5
            camera = Camera(size, size, size / width, size / width, middle, middle, pose)
            positions = vertices.astype(np.float64)
            depth = photograph(positions, triangles, camera)
            still = f"{name} {round(float(time) * _FRAME_RATE)}"
            stills.append(Still(still, positions, triangles, camera, depth, light, 0.01))
    return stills


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
    views = [
        [still for still in stills if still.name.split()[0] == name]
        for name in dict.fromkeys(n.split()[0] for n in names)
    ]
    chosen_stills = [views[0][0], views[0][2], views[0][-1], views[1][0], views[1][-1], views[2][0]]
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


def draw_museum(rows: list[dict[str, Any]], stills: list[Still], path: Path) -> None:
    """Table 2: nodes in the paper's four views, and in ours."""
    pyplot = plotting()

    figure, both = pyplot.subplots(1, 2, figsize=(9.5, 3.6), sharey=True, layout="constrained")
    ours = {v: tuple(row["nodes"] / 1e6 for row in rows if row["variant"] == v) for v in _FIGURE_6}
    titles = ("the paper's Table 2, 1024 x 1024", f"here, {stills[0].camera.width} x {stills[0].camera.height}")
    for axes, values, title in zip(both, (_PAPER_NODES, ours), titles, strict=True):
        for k, variant in enumerate(_FIGURE_6):
            places = np.arange(4) + 0.2 * (k - 1.5)
            axes.bar(places, values[variant], 0.2, color=_COLORS[variant], label=variant)
        axes.set_yscale("log")
        labels = [f"view {k + 1}" for k in range(4)] if values is _PAPER_NODES else [still.name for still in stills]
        axes.set_xticks(range(4), labels)
        axes_style(axes, title, "", "million nodes" if values is _PAPER_NODES else "")
    both[0].legend(fontsize=7)
    save(figure, path)


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
    parser.add_argument("--procedural", action="store_true", help="the procedural robots even where there are data")
    parser.add_argument("--out", type=Path, help="folder for the pictures; none are drawn without it")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    title = "Cone hierarchy: the paper's figures 6 and 7, and Table 2"
    header(title)
    print(threads(1) + "\n")
    robots = [] if options.procedural else bart(options.size)
    robots = robots or walkers(options.size, options.triangles)
    rows = {}
    for name, stills, variants in (
        ("figures 6 and 7", robots, _VARIANTS),
        ("table 2", museum(options.museum_size, options.triangles), _TABLE_2),
    ):
        print(f"\n{name}: {len(stills[0].triangles):,} triangles, {stills[0].camera.width} x {stills[0].camera.height}")
        bench = Bench(stills, options.device, not options.two_sided)
        rows[name] = measure(bench, stills, variants, options.frames)
        _show(rows[name], stills, "nodes", compact)
        _show([row for row in rows[name] if row["variant"] in _FIGURE_6], stills, "below the root", compact)
        _show(rows[name], stills, "ms", lambda ms: f"{ms:.1f}")
        _show([row for row in rows[name] if row["sort"] > 0], stills, "sort", lambda part: f"{100 * part:.0f} %")
        if options.out:
            number = name.replace(" ", "_")
            if name == "table 2":
                draw_museum(rows[name], stills, options.out / f"papers_cone_{number}.png")
            else:
                draw(rows[name], bench, stills, options.out / f"papers_cone_{number}.png")
        everything = [{"experiment": key, **row} for key, found in rows.items() for row in found]
        write_json(title, everything, options.json)


if __name__ == "__main__":
    main()
