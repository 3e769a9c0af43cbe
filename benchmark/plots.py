# SPDX-License-Identifier: Apache-2.0
"""Plots of a run of the suite: ``python benchmark/plots.py results.json FOLDER`` draws all it has figures for."""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Rows = list[dict[str, Any]]

_INK, _QUIET, _GRID = "#222222", "#666666", "#dddddd"
# Colour, marker and name by what a method's name begins with: ours filled, peers open. Colours of Okabe and Ito.
_STYLE = (
    ("auto", "#000000", "*", "auto"),
    ("light_grid/packed", "#0072b2", "o", "light_grid"),
    ("cone_hierarchy/linear", "#009e73", "s", "cone_hierarchy"),
    ("mesh_bvh/refit", "#56b4e9", "D", "mesh_bvh"),
    ("Embree", "#d55e00", "v", "Embree"),
    ("Open3D", "#e69f00", "^", "Open3D"),
    ("wp.Mesh build", "#cc79a7", "<", "wp.Mesh, built"),
    ("wp.Mesh refit", "#8f4f78", ">", "wp.Mesh, refitted"),
)


def draw(results: dict[str, Any], folder: Path) -> list[Path]:
    """Write the plots that there are figures for into ``folder``; returns their paths."""
    rows = {name: section["rows"] for name, section in results["sections"].items()}
    caption = _caption(results)
    made = []
    if rows.get("scenes"):
        made.append(_save(_scenes(rows["scenes"], caption), folder / "benchmark_scenes.png"))
    scaling = {what: rows[what] for what in ("rays", "triangles", "lights") if rows.get(what)}
    if scaling:
        made.append(_save(_scaling(scaling, caption), folder / "benchmark_scaling.png"))
    if rows.get("maps"):
        made.append(_save(_maps(rows["maps"], caption), folder / "benchmark_shadow_map.png"))
    if rows.get("memory"):
        made.append(_save(_memory(rows["memory"], caption), folder / "benchmark_memory.png"))
    return made


def _caption(results: dict[str, Any]) -> str:
    machine = results["machine"]
    changed = " and changes" if machine["changed since"] else ""
    packages = {"warp-lang": "", "embreex": "Embree", "open3d": "Open3D"}  # and who takes part by them
    absent = results.get("absent", {})
    peers = ", ".join(
        f"{name} {machine[name]}" for name, peer in packages.items() if name in machine and peer not in absent
    )
    return (
        f"{machine['processor']}, {results['threads']} core(s) for each method, {peers}, commit "
        f"{machine['commit']}{changed}. Medians; every answer was compared."
    )


def _style(method: str) -> tuple[str, str, str] | None:
    return next((style[1:] for style in _STYLE if method.startswith(style[0])), None)


def _is_ours(method: str) -> bool:
    return "/" in method


def _figure(columns: int, width: float, height: float, caption: str) -> tuple[Figure, list[Axes]]:
    figure, axes = pyplot.subplots(1, columns, figsize=(width, height), squeeze=False)
    figure.text(0.01, 0.01, textwrap.fill(caption, int(16 * width)), fontsize=7, color=_QUIET, va="bottom")
    for each in axes[0]:
        each.spines[["top", "right"]].set_visible(False)
        each.spines[["left", "bottom"]].set_color(_QUIET)
        each.tick_params(colors=_INK, labelsize=8.5)
        each.grid(True, color=_GRID, linewidth=0.6)
        each.set_axisbelow(True)
    return figure, list(axes[0])


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    return path


def _mark(method: str, colour: str, marker: str) -> dict[str, Any]:
    mark = {"color": colour, "marker": marker, "markersize": 7, "markeredgewidth": 1.4}
    if marker == "*":  # around whatever it has chosen
        return {**mark, "markerfacecolor": "none", "markersize": 14, "zorder": 5}
    return {**mark, "markerfacecolor": colour if _is_ours(method) else "white"}


def _number(value: float) -> str:
    return f"{value:g}" if value < 1000 else f"{value / 1000:g}k" if value < 1e6 else f"{value / 1e6:g}M"


def _plain(axis: Any) -> None:
    """Powers of ten and their halves and doubles in plain figures."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _number(value)))
    axis.set_minor_formatter(NullFormatter())


def _scenes(rows: Rows, caption: str) -> Figure:
    """A line of marks per view, on a scale of milliseconds: left the mesh new in every frame, right as it was."""
    names = list(dict.fromkeys(row["view"] for row in rows))
    triangles = {row["view"]: row["triangles"] for row in rows}
    figure, axes = _figure(2, 11, 1.7 + 0.42 * len(names), caption)
    titles = ("Mesh new in every frame: structure and query", "Mesh as before: ours whole, peers' query alone")
    for each, motion, title in zip(axes, ("dynamic ms", "static ms"), titles, strict=True):
        for row in rows:
            style = _style(row["method"])
            twin = motion == "static ms" and row["method"].startswith("wp.Mesh refit")  # the same query as when built
            if style and row[motion] and not twin:
                each.plot(row[motion], names.index(row["view"]), linestyle="", **_mark(row["method"], *style[:2]))
        each.set_xscale("log")
        _plain(each.xaxis)
        each.set_title(title, fontsize=10, color=_INK, loc="left")
        each.set_xlabel("milliseconds per frame", fontsize=9, color=_INK)
        each.set_ylim(len(names) - 0.5, -0.5)
    axes[0].set_yticks(range(len(names)), [f"{name}\n{triangles[name]:,} triangles" for name in names], fontsize=7.5)
    axes[1].set_yticks(range(len(names)), [""] * len(names))
    _legend(figure, rows)
    figure.tight_layout(rect=(0, 0.03, 1, 0.94))
    return figure


def _legend(figure: Figure, rows: Rows) -> None:
    methods = {row["method"] for row in rows}
    handles, labels = [], []
    for begin, colour, marker, label in _STYLE:
        method = next((method for method in methods if method.startswith(begin)), None)
        if method:
            handles.append(pyplot.Line2D([], [], linestyle="", **_mark(method, colour, marker)))
            labels.append(label)
    figure.legend(handles, labels, ncols=len(labels), loc="upper center", frameon=False, fontsize=9, handletextpad=0.1)


def _scaling(sections: dict[str, Rows], caption: str) -> Figure:
    figure, axes = _figure(len(sections), 11, 4.6, caption)
    for each, (what, rows) in zip(axes, sections.items(), strict=True):
        first = rows[0]["view"]
        # Of several views the first; with more triangles the view stays.
        shown = [row for row in rows if row["view"] == first and row["dynamic ms"]]
        for method in dict.fromkeys(row["method"] for row in shown):
            style = _style(method)
            line = sorted((row[what], row["dynamic ms"]) for row in shown if row["method"] == method)
            if style:
                each.plot(*zip(*line, strict=True), linewidth=1.3, **_mark(method, *style[:2]))
        _guide(each, [(row[what], row["dynamic ms"]) for row in shown])
        each.set_xscale("log")
        each.set_yscale("log")
        _plain(each.yaxis)
        numbers = sorted({row[what] for row in shown})
        each.set_xticks(numbers, [_number(float(f"{number:.3g}")) for number in numbers])
        each.set_xticks([], minor=True)
        each.set_title(f"{what}: {first}", fontsize=10, color=_INK, loc="left")
        each.set_xlabel(f"number of {what}", fontsize=9, color=_INK)
    axes[0].set_ylabel("milliseconds per frame, mesh new in every frame", fontsize=9, color=_INK)
    _legend(figure, [row for rows in sections.values() for row in rows])
    figure.tight_layout(rect=(0, 0.04, 1, 0.91))
    return figure


def _guide(axes: Axes, points: Iterable[tuple[float, float]]) -> None:
    """A line of slope one below the marks."""
    x, y = zip(*points, strict=True)
    if max(x) > min(x):
        start = 0.55 * min(y)
        end = min(max(x), min(x) * 0.7 * max(y) / start)
        axes.plot([min(x), end], [start, start * end / min(x)], color=_QUIET, linewidth=1, linestyle=":")
        axes.annotate(
            "linear", (min(x), start), xytext=(10, 0), textcoords="offset points", fontsize=8, color=_QUIET, va="center"
        )


def _maps(rows: Rows, caption: str) -> Figure:
    """Wrong pixels over the size of the map."""
    figure, (axes,) = _figure(1, 7.5, 4.2, caption)
    colours = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
    for view, colour in zip(dict.fromkeys(row["view"] for row in rows), colours, strict=False):
        line = [row for row in rows if row["view"] == view]
        errors = [row["wrong %"] for row in line]
        axes.plot([row["map"] for row in line], errors, "o-", color=colour, label=view, linewidth=1.5)
    axes.axhline(0.0, color=_INK, linewidth=2.5)
    axes.annotate("shadow_tracer: 0, whatever the light", (rows[0]["map"], 0.0), xytext=(0, -5), fontsize=9,
                  textcoords="offset points", va="top", color=_INK)  # fmt: skip
    axes.set_xscale("log", base=2)
    sizes = sorted({row["map"] for row in rows})
    axes.set_xticks(sizes, [f"{size}²" for size in sizes])
    axes.set_ylim(bottom=-0.08 * max(row["wrong %"] for row in rows))
    axes.set_xlabel("texels of each map of the cube around the light", fontsize=9, color=_INK)
    axes.set_ylabel("wrong pixels [%]", fontsize=9, color=_INK)
    axes.set_title("A shadow map with the bias that suits it best: pixels it gets wrong", fontsize=10, loc="left")
    axes.legend(frameon=False, fontsize=9)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    return figure


def _memory(rows: Rows, caption: str) -> Figure:
    """Megabytes that a process gets larger by."""
    shown = sorted(rows, key=lambda row: -row["more MB"])
    figure, (axes,) = _figure(1, 7.5, 1.4 + 0.26 * len(shown), caption)
    colours = ["#0072b2" if _is_ours(row["method"]) else "#d55e00" for row in shown]
    axes.barh([row["method"] for row in shown], [row["more MB"] for row in shown], color=colours, height=0.62)
    for place, row in enumerate(shown):
        axes.annotate(f"{row['more MB']:.0f}", (row["more MB"], place), xytext=(4, 0), va="center", fontsize=8,
                      textcoords="offset points")  # fmt: skip
    axes.grid(False, axis="y")
    first = shown[0]
    title = f"Memory at most, beyond Warp itself: {first['triangles']:,} triangles, {first['rays']:,} rays"
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel("MB", fontsize=9, color=_INK)
    figure.tight_layout(rect=(0, 0.06, 1, 1))
    return figure


if __name__ == "__main__":
    for written in draw(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2])):
        print(written)
