# SPDX-License-Identifier: Apache-2.0
"""The suite's figures as docs/performance.md shows them."""

from __future__ import annotations

from typing import Any

import suite_tables


def _row(method: str, dynamic: float | None, static: float | None, **more: Any) -> dict[str, Any]:
    found = {"view": "v", "triangles": 70_008, "rays": 5_000, "lights": 1, "in shadow": 0.204, "method": method}
    return {**found, "dynamic ms": dynamic, "static ms": static, **more}


_ROWS = [
    _row("auto/measured", 8.0, 7.04),
    _row("wp.Mesh refit + any-hit", 3.0, 40.0),  # keeps its tree: no peer of a frame in which everything is new
    _row("wp.Mesh build + any-hit", 48.2, 30.0),
    _row("Embree build + occluded", 72.0, 14.0),
    _row("brute_force/filtered (1,500 samples)", 900.0, 800.0),
]


def test_a_view_is_a_line_and_the_best_peer_stands_at_its_end() -> None:
    head, _, line = suite_tables.beside(_ROWS, "dynamic").split("\n")
    cells = dict(zip(head.split(" | "), line.split(" | "), strict=True))
    assert line.startswith("| v | 70,008 | 20 % | 8.0 |") and line.endswith(" | **6.0** |")
    assert cells["wp.Mesh refit"] == "3.0" and cells["Open3D build"] == "-", "one that was not measured has no time"
    static = suite_tables.beside(_ROWS, "static", of_points=True)
    assert "Embree query" in static and static.endswith(" | **2.0** |")
    assert "| v | 70,008 | 5,000 | 7.0 |" in static


def test_growth_stands_in_brackets() -> None:
    more = [
        _row("auto/measured", 24.0, None, rays=10_000, growth=1.5),
        _row("Embree build + occluded", 60.0, None, rays=10_000),
    ]
    lines = suite_tables.growing([*_ROWS, *more], "rays").split("\n")
    assert lines[2].startswith("| 5,000 | 8.0 |") and lines[3].startswith("| 10,000 | 24 (1.50) |")
    assert lines[3].endswith(" | **2.5** |")


def test_sections_that_were_not_measured_are_not_there() -> None:
    found = suite_tables.tables({"sections": {"points": {"rows": _ROWS}}})
    assert found.count("## ") == 2 and "## points, static, ms" in found
