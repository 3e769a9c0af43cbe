# SPDX-License-Identifier: Apache-2.0
"""What makes answers about cones certain, taken out piece by piece: their tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_OUTCOMES, _HITS, _BOXES = "../test_tracer_cones.py", "../test_tracer_cone_hits.py", "accelerators/bvh/test_cones.py"
_OUTCOME, _WALK = "accelerators/cone_outcome.h", "accelerators/bvh/cone_walk.h"
_BLOCK, _SIXTEEN = "accelerators/bvh/test_cone_block.py", "accelerators/bvh/cone_block.h"
_MUTANTS: dict[str, tuple[str, str, Change]] = {
    "neighbours that came apart": (
        _OUTCOMES,
        "come_apart",
        (
            _OUTCOME,
            "if (!(from.same(a.place) && to.same(b.place)) && !(from.same(b.place) && to.same(a.place)))",
            "if (0)",
        ),
    ),
    "neighbours on either side": (
        _OUTCOMES,
        "edge_to_edge",
        (
            _OUTCOME,
            "return Cone::edge_plane(a, b, plane).dot(third) <",
            "return true ? other : Cone::edge_plane(a, b, plane).dot(third) <",
        ),
    ),
    "edges without a neighbour": (
        _OUTCOMES,
        "edge_to_edge",
        (_OUTCOME, "return other >= 0 && sheet.add(", "return other < 0 || sheet.add("),
    ),
    "sheets through the end": (_OUTCOMES, "reaches_through", (_OUTCOME, "|| !cone.before_end(a, b, c, plane)", "")),
    "triangles without area": (_OUTCOMES, "casts_nothing", (_OUTCOME, "|| Cone::flat(p, q, r)", "")),
    "answers of a budget that was too small": (
        _OUTCOMES,
        "budget",
        (_OUTCOME, "return walk.spent > walk.budget ? CONE_PARTLY : met", "return met"),
    ),
    "covers by planes of any place": (
        _OUTCOMES,
        "reaches_through",
        ("exact/cone.h", "return cut_by(p) && on_side", "return on_side"),
    ),
    "bands that forgive": (_OUTCOMES, "rims", ("accelerators/cone_kernels.py", "CONE_BAND=1e-13", "CONE_BAND=-1e-13")),
    "rough bands that forgive": (
        _OUTCOMES,
        "rims",
        ("accelerators/cone_kernels.py", "CONE_ROUGH=2.0**-17", "CONE_ROUGH=-0.1"),
    ),
    "ties in any order": (
        _HITS,
        "order",
        ("accelerators/cone_hits.h", "(t == other_t && number < other)", "t == other_t"),
    ),
    "lists cut by the box before": (
        _HITS,
        "order",
        (_WALK, "Arithmetic::mul(out, unit) >= after", "Arithmetic::mul(in, unit) >= after"),
    ),
    "half-lines of the axis alone": (
        _BOXES,
        "rejected",
        (
            "accelerators/half_lines.h",
            "plus[k] = steep(Arithmetic::add(way[k], Arithmetic::add(aside, lean)));",
            "plus[k] = steep(way[k]);",
        ),
    ),
    "planes of triangles without what the cone is wide": (
        _BLOCK,
        "left_out",
        (_SIXTEEN, "along * sign + slope * aside(normal, along)", "along * sign"),
    ),
    "planes of edges without what the cone is wide": (
        _BLOCK,
        "left_out",
        (_SIXTEEN, "(turned + wide < -pad)", "(turned < -pad)"),
    ),
    "sides of planes that are not known": (
        _BLOCK,
        "left_out",
        (_SIXTEEN, "sided = far_off > doubt", "sided = far_off >= none"),
    ),
    "sheets that the axis misses": (
        _OUTCOMES,
        "beside_rays",
        (_OUTCOME, "        return axis;", "        return true;"),
    ),
    "hints with a budget": (_OUTCOMES, "without_hints", (_OUTCOME, "asked.budget < NO_BUDGET ? -1 : hint", "hint")),
    "sixteen boxes by the axis alone": (
        _OUTCOMES,
        "beside_rays",
        (_WALK, "most[k] = (float)plus[k];", "most[k] = (float)steep(way[k]);"),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(_MUTANTS))
def test_its_tests_see_it(name: str, tmp_path: Path, kernels: Path) -> None:
    tests, some, change = _MUTANTS[name]
    assert failing_tests([change], tests, some, tmp_path, kernels, first=True)
