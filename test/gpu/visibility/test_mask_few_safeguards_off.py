# SPDX-License-Identifier: Apache-2.0
"""What keeps lights of few points right, and samples on triangles that follow each other, taken out piece by piece:
their tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_FILTER, _WALK, _MASK = "exact/mask_filter.h", "accelerators/bvh/mask_walk.h", "visibility/mask.h"
_OWN = "visibility/test_mask_few.py"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "whatever may be is hidden": (
        "edges_and_planes",
        [(_MASK, "while (maybe && !hides(k, triangles[__builtin_ctz(maybe)]))", "while (false)")],
    ),
    "what is not sure is seen": (
        "edges_and_planes",
        [(_WALK, "left = doubtful & ~hidden; left;", "left = 0; left;")],
    ),
    "fronts that cast": (
        "edges_and_planes and True",
        [(_WALK, "certain = query.asked.cull == 0 ? (int)Lanes16::ALL : 0", "certain = Lanes16::ALL")],
    ),
    "fronts that hide all": (
        "edges_and_planes and True and small",
        [(_WALK, "if (all && query.asked.cull == 0) {", "if (all) {")],
    ),
    "what the forms say nothing of": (
        "edges_and_planes",
        [(_WALK, "query.open ? filter.may & ~filter.told : 0", "0")],
    ),
    "forms of another block": (
        "edges_and_planes",
        [
            (
                _FILTER,
                "sure = told & Lanes16::bits(least > 1.0f), maybe = told &",
                "sure = Lanes16::bits(least > 1.0f), maybe =",
            )
        ],
    ),
    "the next triangle hides what it may": (
        "follow_each_other",
        [(_MASK, "asked.middle[3]) == ALL;\n        if (follows)", "asked.middle[3]) != NONE;\n        if (follows)")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, _OWN, f"({some}) and usual", tmp_path, kernels, first=True)
