# SPDX-License-Identifier: Apache-2.0
"""The programs that repeat the papers' experiments run on tiny scenes, and what they compute from counts is right."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp")
pytest.importorskip("PIL")

_ROOT = Path(__file__).resolve().parents[2]
_BENCHMARK = _ROOT / "benchmark"


@pytest.fixture
def light_grid(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(_BENCHMARK))
    import papers_light_grid

    return papers_light_grid


def _run(program: str, folder: Path, *options: str) -> tuple[str, list[dict[str, Any]]]:
    path = folder / "result.json"
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "SHADOW_TRACER_DATA": str(folder / "nothing")}
    command = [sys.executable, str(_BENCHMARK / program), "--json", str(path), *options]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout, json.loads(path.read_text())["rows"]


@pytest.mark.slow
def test_cone_hierarchy_without_data(tmp_path: Path) -> None:
    sizes = ("--size", "24", "--museum-size", "16", "--triangles", "2000", "--frames", "1")
    text, rows = _run("papers_cone_hierarchy.py", tmp_path, *sizes)
    assert "skipped without the data folder" in text and "procedural robots" in text
    figures = [row for row in rows if row["experiment"] == "figures 6 and 7"]
    assert len(figures) == 8 * 15 and len(rows) - len(figures) == 5 * 4
    assert all(row["ms"] > 0.0 and row["nodes"] >= 0 and row["culled"] > 0 for row in rows)
    # In the same frame the precise test, and sorting in the museum, leave fewer nodes to visit.
    nodes = {(row["still"], row["variant"]): row["nodes"] for row in rows}
    assert nodes["corridor 0", "precise"] < nodes["corridor 0", "spheres"]
    assert nodes["room, inside", "precise_sorted"] < nodes["room, inside", "precise"]


@pytest.mark.slow
def test_light_grid_without_data(tmp_path: Path) -> None:
    sizes = ("--size", "24", "--triangles", "2000", "--frames", "1", "--procedural")
    text, rows = _run("papers_light_grid.py", tmp_path, *sizes)
    assert "Table 1 without Fairy" in text
    table = [row for row in rows if row["experiment"] == "table 1"]
    assert [row["model"] for row in table] == ["procedural robots"]
    items = {row["r"]: row["work items"] for row in rows if row.get("distance") == 1.0 and "work items" in row}
    assert sorted(items, key=str) == sorted([32, 64, 128, 256, 512, "unlimited"], key=str)
    assert items[32] >= items[512] >= items["unlimited"] > 0


def test_no_time_for_a_wrong_mask(light_grid: Any) -> None:
    """One wrong pixel in the mask to compare with, and the program stops."""
    import papers

    still = light_grid.walking(24, 2000)
    bench = papers.Bench([still], "cpu", False)
    bench.tracer.select("light_grid", "packed")
    assert bench.measure(still, 1).milliseconds > 0.0
    bench.mask(still)[11, 13] ^= 1
    with pytest.raises(SystemExit, match="differs from mesh_bvh in 1 pixels"):
        bench.measure(still, 1)


def test_work_items(light_grid: Any) -> None:
    """Tile 3 has 70 rays of 1 test but for one of 9, tile 8 has two."""
    tiles = np.array([3] * 70 + [8] * 2)
    tests = np.ones(72, int)
    tests[40] = 9
    assert light_grid.work_items(tiles, tests, 32).tolist() == [1, 9, 1, 1]
    assert light_grid.work_items(tiles, tests, 64).tolist() == [10, 1, 1]
    assert light_grid.work_items(tiles, tests, 1 << 22).tolist() == [11, 1]


def test_busiest(light_grid: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two workers: 5 for the first; 1, 1, 4 for the second; the last goes to the one that is done first."""
    monkeypatch.setattr(light_grid, "_WORKERS", 2)
    assert light_grid.busiest(np.array([5, 1, 1, 4, 2])) == 7
    assert light_grid.busiest(np.array([3])) == 3
