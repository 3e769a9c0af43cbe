# SPDX-License-Identifier: Apache-2.0
"""Trees beside their peers, on a tiny scene: every step of each has a time, and no wrong answer has one."""

from __future__ import annotations

import bvh_peers
import pytest
from case import Case
from rivals import missing
from scenes import procedural_view


@pytest.mark.slow
def test_all_methods_take_part() -> None:
    rows = {row["method"]: row for row in bvh_peers.measure(procedural_view("robots", "wall", "sun", 16, 600, 2), 1, 1)}
    assert {"wp.Mesh", *bvh_peers._VARIANTS, *({"Embree"} - set(missing()))} == set(rows)
    for name, row in rows.items():
        assert row["build ms"] > 0.0 and row["any hit ms"] > 0.0 and row["wrong rays"] == 0
        assert name in ("Embree", "wp.Mesh") or row["whole ms"] > row["any hit ms"]


def test_a_wrong_answer_stops_it() -> None:
    case = Case(procedural_view("robots", "wall", "sun", 16, 600, 2), 2)
    ours = bvh_peers._Ours("bvh/median", case, bvh_peers._Clock(1), 1)
    ours.turn()
    case.dynamic[0][0, 5] ^= True
    with pytest.raises(SystemExit, match="bvh/median differs from mesh_bvh in 1 rays"):
        ours.turn()
