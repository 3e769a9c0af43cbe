# SPDX-License-Identifier: Apache-2.0
"""What keeps masks of light points exact, taken out piece by piece: their tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_MASK = "visibility/mask.h"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "a filter without a pad": ("roundings", [("visibility/queries.py", "MASK_PAD = 1e-14", "MASK_PAD = 0.0")]),
    "a pilot of one column": (
        "both_halves",
        [
            (
                _MASK,
                "(wp::uint64)(mixed ^ mixed >> 16) * (wp::uint64)asked.every >> 32 == 0",
                "(mixed = number) % asked.every == 0",
            )
        ],
    ),
    "any bias": (
        "same_points",
        [
            (_MASK, "bias > 0.0 ? Bits(least > 1.000000000001 * bias * most) : other", "other"),
            (_MASK, "maybe &= ~(same | before);", "maybe &= ~same;"),
        ],
    ),
    "fronts that cast": ("sequences", [(_MASK, "asked.cull == 0 ? bits(sure) : 0", "bits(sure)")]),
    "one ray for the bundle": (
        "same_points",
        [
            ("accelerators/segment.h", "beside[k] = WIDER *", "beside[k] = 0.0 *"),
            ("accelerators/bvh/bundle_sides.h", "faster = WIDER *", "faster = 0.0 *"),
        ],
    ),
    "boxes met by the middle ray alone": (
        "same_points",
        [("accelerators/bvh/bundle_sides.h", "faster = WIDER *", "faster = 0.0 *")],
    ),
    "the scene's box met by the middle ray alone": (
        "same_points",
        [("accelerators/segment.h", "beside[k] = WIDER *", "beside[k] = 0.0 *")],
    ),
    "a pyramid for a sample within the light": (
        "in_the_middle",
        [("accelerators/bvh/bundle_sides.h", "const bool cone = faster < STEEPEST;", "const bool cone = true;")],
    ),
    "all points where the middle is": (
        "same_points",
        [(_MASK, "low = at - beside - pad, high = at + beside + pad;", "low = at - pad, high = at + pad;")],
    ),
    "all points without a pad": (
        "roundings",
        [
            (
                _MASK,
                "low = at - beside - pad, high = at + beside + pad;",
                "low = at - 0.9 * beside, high = at + 0.9 * beside;",
            )
        ],
    ),
    "all points with any bias": (
        "same_points",
        [(_MASK, "inside && after && least_behind > 0.0", "inside && least_behind > 0.0")],
    ),
    "fronts that cast for all points": ("sequences", [(_MASK, " && asked.cull == 0 ? ALL", " ? ALL")]),
    "surely before the bias": (
        "same_points",
        [
            (
                _MASK,
                "const Bits before = 1.000000000001 * most_here < bias * fewest;",
                "const Bits before = most_here < 2.0 * bias * fewest;",
            )
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
