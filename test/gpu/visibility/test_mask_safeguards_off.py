# SPDX-License-Identifier: Apache-2.0
"""What keeps masks of light points exact, taken out piece by piece: their tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_MASK = "visibility/mask.h"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "a filter without a pad": ("roundings", [("visibility/queries.py", "MASK_PAD = 1e-14", "MASK_PAD = 0.0")]),
    "any bias": (
        "same_points",
        [(_MASK, "bias > 0.0 ? Bits(least > 1.000000000001 * bias * most) : other", "other")],
    ),
    "fronts that cast": ("sequences", [(_MASK, "asked.cull == 0 ? bits(sure) : 0", "bits(sure)")]),
    "one ray for the bundle": (
        "same_points",
        [("accelerators/segment.h", "Query1::SPREADS ? query.spread()", "false ? 0.0")],
    ),
    "boxes met by the middle ray alone": (
        "same_points",
        [
            ("accelerators/segment.h", "Query1::SPREADS ? origin[k] + (float)beside : origin[k]", "origin[k]"),
            ("accelerators/segment.h", "Query1::SPREADS ? origin[k] - (float)beside : origin[k]", "origin[k]"),
        ],
    ),
    "opposite sides not asked for": (
        "same_points",
        [(_MASK, "hidden = all & other & after;", "hidden = all & after;")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, "visibility/test_mask.py", f"({some}) and refit", tmp_path, kernels, first=True)
