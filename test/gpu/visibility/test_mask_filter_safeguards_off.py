# SPDX-License-Identifier: Apache-2.0
"""What keeps the float32 filter for masks of light points right, taken out piece by piece: its tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_FILTER, _CONSTANTS = "exact/mask_filter.h", "exact/mask_filter.py"
_MASK = "visibility/mask.h"
_OWN, _OTHER = "visibility/test_mask_filter.py", "visibility/test_mask.py"
_MUTANTS: dict[str, tuple[str, str, list[Change]]] = {
    "no bands": (
        _OWN,
        "edges_within",
        [(_CONSTANTS, "MASK_BAND=2.0**-19, MASK_PLACE=2.0**-22", "MASK_BAND=2.0**-40, MASK_PLACE=2.0**-40")],
    ),
    "a band of the distance alone": (
        _OWN,
        "edges_within",
        [(_CONSTANTS, "MASK_PLACE=2.0**-22", "MASK_PLACE=2.0**-40")],
    ),
    "a sure side of the sample": (
        _OWN,
        "planes_within",
        [(_FILTER, "clear = Lanes16::bits(distance - here >", "clear = Lanes16::bits(distance >")],
    ),
    "surely before the bias": (
        _OWN,
        "planes_within",
        [(_FILTER, "nearest * (away - wide) > distance + here", "nearest * (away - wide) > 0.5f * distance")],
    ),
    "any bias": (
        _OWN,
        "planes_within",
        [(_FILTER, "distance - here > farthest * (away + wide)", "distance - here > none")],
    ),
    "all edges as those of the middle": (
        _OWN,
        "any_order or edges_within",
        [
            (
                _FILTER,
                "const float* e = filter.extent;",
                "return Real16(0.0f);\n            const float* e = filter.extent;",
            )
        ],
    ),
    "lengths to the middle of the box": (
        _OWN,
        "planes_within and rectangle",
        [(_MASK, "least = apart > e[k] ? apart - e[k] : 0.0", "least = apart")],
    ),
    "the sample's distance at infinity": (
        _OWN,
        "steep_before_the_sun",
        [(_FILTER, "plane.value - w * off", "plane.value - off")],
    ),
    "beyond the plane or not": (
        _OWN,
        "within_roundings_of_triangles",
        [(_FILTER, "per_both = sign * Lanes16::inverse(there + here)", "per_both = 1e20f * sign")],
    ),
    "lengths that float32 does not hold": (
        _OWN,
        "lengths_beyond",
        [(_FILTER, "return sum > MASK_SMALLEST && sum < MASK_LARGEST && metres", "return metres > 0.0 || metres")],
    ),
    "fronts that cast": (
        _OTHER,
        "sequences",
        [(_MASK, "asked.cull == 0 ? hidden & ~sure : hidden", "hidden & ~sure")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    file, some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, file, f"({some}) and bvh and sah and usual", tmp_path, kernels, first=True)
