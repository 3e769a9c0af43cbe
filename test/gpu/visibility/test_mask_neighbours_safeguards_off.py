# SPDX-License-Identifier: Apache-2.0
"""What keeps samples that are looked at together right, taken out piece by piece: their tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_SHAFT, _WALK, _MASK = "accelerators/bvh/shaft.h", "accelerators/bvh/mask_walk.h", "visibility/mask.h"
_OWN = "visibility/test_mask_neighbours.py"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "the first sample for all": (
        "specks or many_groups",
        [(_MASK, "high[k] = at[k] > high[k] ? at[k] : high[k];", "")],
    ),
    "neighbours before the last": (
        "specks or many_groups",
        [(_MASK, "number < neighbours.end && number < asked.samples", "number < neighbours.end - 4")],
    ),
    "the middle of the light": ("specks", [(_SHAFT, "WIDER * query.spread()[k]", "0.0 * query.spread()[k]")]),
    "as wide everywhere as the samples": (
        "specks",
        [
            (_SHAFT, "there + spread - (finite ? to : 0.0)", "there - (finite ? 0.5 * (from + to) : 0.0)"),
            (_SHAFT, "there - spread - (finite ? from : 0.0)", "there - (finite ? 0.5 * (from + to) : 0.0)"),
        ],
    ),
    "samples at any distance": (
        "far_from_the_scene",
        [(_SHAFT, "!(fabs(from) <= SHAFT_PLACE) || !(fabs(to) <= SHAFT_PLACE)", "from != from")],
    ),
    "half the way": ("specks", [(_SHAFT, "Segment::holding(1.0)", "0.5f")]),
    "pixels in tiles as neighbours": (
        "images",
        [(_WALK, "query.asked.every != 1 || query.asked.width > 0", "query.asked.every != 1")],
    ),
    "the columns that no tile has": ("images", [(_MASK, "+ width - columns + rest % columns", "+ rest % columns")]),
    "tiles in too few rows": ("images", [(_MASK, "number / whole * whole + whole > asked.samples", "number < 0")]),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, _OWN, some, tmp_path, kernels, first=True)
