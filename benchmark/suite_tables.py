# SPDX-License-Identifier: Apache-2.0
"""The suite's figures with a view or a size a line and a method a column, as docs/performance.md shows them.

python benchmark/suite_tables.py benchmark_output/results.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

Rows = list[dict[str, Any]]

_METHODS = {
    "auto/measured": "`auto`",
    "light_grid/packed": "`light_grid`",
    "cone_hierarchy/linear": "`cone_hierarchy`",
    "mesh_bvh/refit": "`mesh_bvh`",
    "bvh/sah": "`bvh`",
    "wp.Mesh refit + any-hit": "wp.Mesh refit",
    "wp.Mesh build + any-hit": "wp.Mesh build",
    "Embree build + occluded": "Embree build",
    "Open3D build + test_occlusions": "Open3D build",
}
_STATIC = {  # their query alone
    **{method: name for method, name in _METHODS.items() if "/" in method},
    "wp.Mesh build + any-hit": "wp.Mesh query",
    "Embree build + occluded": "Embree query",
    "Open3D build + test_occlusions": "Open3D query",
}
_OURS = "auto/measured"


def beside(rows: Rows, kind: str, of_points: bool = False) -> str:
    """A line for each view, of one light.

    Args:
        kind: "dynamic" or "static".
        of_points: the number of samples is told, not what part of them is in shadow.
    """
    names, figure = _METHODS if kind == "dynamic" else _STATIC, f"{kind} ms"
    second = "points" if of_points else "in shadow"
    head = ["view", "triangles", second, *names.values(), "best peer / `auto`"]
    lines = []
    for (view, triangles, rays, _), found in _cases(rows).items():
        times = {row["method"]: row[figure] for row in found if row["method"] in names}
        share = f"{rays:,}" if of_points else f"{100 * found[0]['in shadow']:.0f} %"
        lines.append([view, f"{triangles:,}", share, *(_ms(times.get(method)) for method in names), _gain(times)])
    return _markdown(head, lines)


def growing(rows: Rows, by: str) -> str:
    """A line for each number of ``by``: "rays", "triangles" or "lights"; in brackets how the time has grown since the
    line before, in parts of how much these have."""
    head, lines = [by, *_METHODS.values(), "best peer / `auto`"], []
    for case, found in _cases(rows).items():
        times = {row["method"]: row["dynamic ms"] for row in found if row["method"] in _METHODS}
        growth = {row["method"]: row.get("growth") for row in found}
        cells = [
            _ms(times.get(method)) + (f" ({growth[method]:.2f})" if growth.get(method) is not None else "")
            for method in _METHODS
        ]
        lines.append([f"{case[_PLACES[by]]:,}", *cells, _gain(times)])
    return _markdown(head, lines)


_PLACES = {"triangles": 1, "rays": 2, "lights": 3}


def _cases(rows: Rows) -> dict[tuple[str, int, int, int], Rows]:
    found: dict[tuple[str, int, int, int], Rows] = {}
    for row in (row for row in rows if row["method"] in _METHODS):
        found.setdefault((row["view"], row["triangles"], row["rays"], row["lights"]), []).append(row)
    return found


def _gain(times: dict[str, float | None]) -> str:
    """How many times the best peer that may not keep its tree takes what ``auto`` does."""
    ours = times.get(_OURS)
    peers = [time for method, time in times.items() if time and "/" not in method and "refit" not in method]
    return f"**{min(peers) / ours:.1f}**" if ours and peers else "-"


def _ms(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}" if value >= 1.0 else f"{value:.2f}"


def _markdown(head: list[str], lines: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(cells) + " |" for cells in [head, ["---"] * len(head), *lines])


def tables(results: dict[str, Any]) -> str:
    """All of them, each under a heading."""
    sections, parts = results["sections"], []
    for section, of_points in (("scenes", False), ("points", True)):
        for kind in ("dynamic", "static"):
            if section in sections:
                parts.append(f"## {section}, {kind}, ms\n\n{beside(sections[section]['rows'], kind, of_points)}")
    for by in ("rays", "triangles", "lights"):
        if by in sections:
            parts.append(f"## {by}, ms\n\n{growing(sections[by]['rows'], by)}")
    return "\n\n".join(parts)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit((__doc__ or "").strip())
    print(tables(json.loads(Path(sys.argv[1]).read_text())))
