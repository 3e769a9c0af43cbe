# SPDX-License-Identifier: Apache-2.0
"""The program that repeats the experiments with cones, on tiny scenes; what it counts is what there is, and what was
not shown is found."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import papers_cones
import papers_cones_trees
import procedural
import pytest

_ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def pot() -> tuple[papers_cones.Model, papers_cones_trees.Trees]:
    made = procedural.stadium(300)
    pose = made.eyes["pot"].camera(2).camera_to_world
    model = papers_cones.Model("pot", made.positions[0], made.triangles, [pose])
    return model, papers_cones_trees.Trees(model.vertices, model.triangles)


@pytest.mark.slow
def test_without_data(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "SHADOW_TRACER_DATA": str(tmp_path / "nothing")}
    command = [sys.executable, str(_ROOT / "benchmark" / "papers_cones.py"), "--json", str(path), "--models", "teapot"]
    command += ["--size", "8", "--triangles", "400", "--turns", "1"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert "skipped without the data folder" in done.stdout
    rows = json.loads(path.read_text())["rows"]
    tables = [row for row in rows if row["experiment"] == "tables"]
    assert {row["model"] for row in tables} == {"procedural teapot", "procedural museum"}
    nodes = {(row["model"], row["tree"], row["rays"], row["degrees"]): row["nodes"] for row in tables}
    for model in ("procedural teapot", "procedural museum"):
        for tree in papers_cones_trees.TREES:
            assert 8 * nodes[model, tree, 4, None] < nodes[model, tree, 64, None] < 32 * nodes[model, tree, 4, None]
            assert (model, tree, None, 5.0) in nodes
        wider = [nodes[model, "bvh, 2 children", None, angle] for angle in (0.04, 0.5, 1.5)]
        assert wider == sorted(wider) and wider[0] > 0.0
    away = [row for row in rows if row["experiment"] == "figure 8"]
    assert [row["times as far"] for row in away] == [1, 4, 16, 64] and all(row["us"] > 0.0 for row in away)


def test_a_cone_around_everything_is_shown_everything(pot: Any) -> None:
    """All nodes once, all triangles once; the whole of the bowl is in front."""
    model, trees = pot
    apex, way = np.array([[0.0, 0.0, 5e3]]), np.array([[0.0, 0.0, -1.0]])
    spent = trees.traverse("bvh, 2 children", apex, way, np.tan(0.2))
    assert spent.triangles == spent.most == len(model.triangles)
    assert spent.nodes >= 2 * np.ceil(len(model.triangles) / 16) - 1
    # Some are shown again, in another leaf.
    assert trees.traverse("kd_tree", apex, way, np.tan(0.2)).triangles >= len(model.triangles)
    for tree in ("bvh, 2 children", "kd_tree"):
        nothing = trees.traverse(tree, apex, -way, np.tan(0.2))
        assert nothing.triangles == nothing.nodes == 0


@pytest.mark.parametrize("tree", papers_cones_trees.TREES)
def test_rays_and_thin_cones_meet_the_same(pot: Any, tree: str) -> None:
    model, trees = pot
    apices, ways = papers_cones.directions(model.poses[0], 8, 1)
    rays = trees.traverse(tree, apices, ways, 0.0)
    assert 0.0 < rays.triangles < 0.5 * len(model.triangles) and rays.nodes > 0.0
    cones = trees.traverse(tree, apices, ways, 1e-9)
    assert cones.triangles > 0.0 and cones.nodes > 0.0
    if tree != "bvh, 16 children":  # which looks at the triangles of a block before it shows them
        assert cones.triangles >= 0.9 * rays.triangles


@pytest.mark.parametrize("slope", [0.0, 0.05])
def test_what_was_not_shown_is_found(pot: Any, slope: float, monkeypatch: pytest.MonkeyPatch) -> None:
    model, trees = pot
    apices, ways = papers_cones.directions(model.poses[0], 8, 1)
    monkeypatch.setattr(trees, "_send", lambda *_: None)
    with pytest.raises(SystemExit, match="triangles that are met were not shown"):
        trees.traverse("bvh, 2 children", apices, ways, slope)


def test_of_the_paper_are_as_many_figures_as_ours() -> None:
    for trees in papers_cones.PAPER.values():
        for rows in trees.values():
            assert len(rows) == len(papers_cones._RAYS) + len(papers_cones._ANGLES)
            assert papers_cones._of_the_paper(rows)["4 rays"]


def test_rays_of_a_pixel_are_around_its_middle() -> None:
    pose = procedural.look_at((1.0, 2.0, 3.0), (4.0, 0.0, 3.0), (0.0, 0.0, 1.0))
    one, four = (papers_cones.directions(pose, 4, number)[1] for number in (1, 4))
    assert four.shape == (64, 3)
    four = four.reshape(4, 2, 4, 2, 3).mean(axis=(1, 3)).reshape(-1, 3)
    four /= np.linalg.norm(four, axis=1)[:, None]
    np.testing.assert_allclose(four, one, atol=0.02)
