# SPDX-License-Identifier: Apache-2.0
"""The structures of the lecture side by side, on a tiny scene: each has a row, and none whose mask is wrong."""

from __future__ import annotations

import sys
from typing import Any

import papers_structures
import pytest
from case import Case
from scenes import View, procedural_view

from shadow_tracer import available_pipelines

_ELSEWHERE = {
    "auto/measured",  # one of the others
    "height_field/pyramid",  # of meshes mesh_bvh
    "geometry_image/threaded",  # the same; papers_geometry_image.py
    "brute_force/float64",
    "mesh_bvh/rebuild",
    "mesh_bvh/binary",
    # papers_cone_hierarchy.py
    *(f"cone_hierarchy/{v}" for v in available_pipelines()["cone_hierarchy"] if v != "linear"),
}


def _view() -> View:
    return procedural_view("stadium", "pot", "inside", 12, 400, 3)


def test_no_structure_is_forgotten() -> None:
    known = {f"{name}/{variant}" for name, variants in available_pipelines().items() for variant in variants}
    assert known - _ELSEWHERE == {name for name in papers_structures.STRUCTURES if not name.endswith("single")}


@pytest.mark.slow
def test_all_on_a_tiny_stadium(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {
        row["structure"]: row
        for row in papers_structures.measure(_view(), papers_structures.STRUCTURES, 1, 9.0, dict[str, float]())
    }
    assert tuple(rows) == papers_structures.STRUCTURES
    for name, row in rows.items():
        assert row["turns"] == 1 and row["triangles"] > 0.0 and row["dynamic ms"] > 0.0 and row["static ms"] > 0.0
        # Nothing is made for brute_force; all others count their steps, and hold something.
        made = name != "brute_force/filtered"
        assert (row["steps"] > 0.0) == (row["new ms"] > 0.0) == (row["MB"] > 0.0) == made, name
    assert rows["kd_tree/sah"]["triangles"] < rows["brute_force/filtered"]["triangles"]
    papers_structures.show(list(rows.values()))
    papers_structures.summary(list(rows.values()), ("steps",))
    assert capsys.readouterr().out.count("| bvh/sah single") == 2


def test_what_takes_too_long_is_left_out_and_said(capsys: pytest.CaptureFixture[str]) -> None:
    names, known = ("brute_force/filtered", "kd_tree/sah"), {"kd_tree/sah": 1.0}
    rows = list(papers_structures.measure(_view(), names, 1, 1.0, known))
    assert [row["structure"] for row in rows] == ["brute_force/filtered"]
    assert "kd_tree/sah is left out" in capsys.readouterr().out
    assert 0.0 < known["brute_force/filtered"] < 1.0


def test_a_wrong_mask_has_no_row() -> None:
    case = Case(_view(), 3)
    structure = papers_structures.Structure("octree/parametric", case)
    structure.turn()
    case.static[2][0, 3] ^= True
    with pytest.raises(SystemExit, match="octree/parametric differs from mesh_bvh in 1 rays"):
        structure.turn()


def test_the_program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Any) -> None:
    monkeypatch.setattr(papers_structures, "threads", lambda _: "this process goes on")
    monkeypatch.setenv("SHADOW_TRACER_DATA", str(tmp_path))
    options = ["--size", "8", "--turns", "1", "--structures", "uniform_grid/dda", "--json", str(tmp_path / "rows")]
    views = ["--views", "Sponza", "stadium/pot/inside", "--triangles", "300"]
    monkeypatch.setattr(sys, "argv", ["papers_structures.py", *options, *views])
    papers_structures.main()
    text = capsys.readouterr().out
    assert "skipped without the data folder (set SHADOW_TRACER_DATA): Sponza" in text
    assert text.count("| uniform_grid/dda ") == 8 and (tmp_path / "rows").is_file()
