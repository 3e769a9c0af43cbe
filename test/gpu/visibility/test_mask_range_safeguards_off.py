# SPDX-License-Identifier: Apache-2.0
"""What keeps ranges of light points right, taken out piece by piece: their tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_RANGE, _PYTHON = "exact/mask_range.h", "exact/mask_range.py"
_OWN = "visibility/test_mask_range.py"
_MUTANTS: dict[str, tuple[str, str, list[Change]]] = {
    "pads that are constants": (_OWN, "grazing", [(_RANGE, "pad = 1.1f * most *", "pad = 0.0f * most *")]),
    "no pads": (
        _OWN,
        "small_triangles",
        [
            (_RANGE, "const Real16 pad = 1.1f", "const Real16 pad = 0.0f * 1.1f"),
            (_PYTHON, "RANGE_PAD=1e-4", "RANGE_PAD=-0.02"),
        ],
    ),
    "corners behind the sample": (
        _OWN,
        "beside_and_behind",
        [(_RANGE, "nearest > (float)RANGE_SURE * wrong", "nearest != wrong")],
    ),
    "a sphere that is flat": (
        "visibility/test_mask_filter.py",
        "edges_within and sphere and sah and usual",
        [(_PYTHON, "<= FLAT * min(halves)", "<= 10.0 * min(halves)")],
    ),
    "a bin less": (
        _OWN,
        "small_triangles",
        [(_RANGE, "scale[number] + behind[number]", "scale[number]")],
    ),
    "tubes that are lines": (_OWN, "rays_to_tubes", [(_RANGE, "slack[0] += (float)(", "slack[0] += 0.0f * (float)(")]),
    "tubes around the sample": (_OWN, "rays_to_tubes", [(_RANGE, "part < RANGE_ROUND", "part < 1e9")]),
    "ribbons of half the width": (_OWN, "rays_to_tubes", [(_RANGE, "wider = radius /", "wider = 0.5 * radius /")]),
    "boxes behind the sample": (
        _OWN,
        "boxes_around",
        [(_RANGE, "depth.low > (float)RANGE_SURE", "depth.high > (float)RANGE_SURE")],
    ),
    "boxes by their far ends": (
        _OWN,
        "columns",
        [
            (_RANGE, "at.low < none ? most : least", "at.low < none ? least : least"),
            (_RANGE, "at.high > none ? most : least", "at.high > none ? least : least"),
        ],
    ),
    "points of the bin before": (
        _OWN,
        "sides_of",
        [(_PYTHON, "bins >= np.arange", "bins > np.arange")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    file, some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, file, some, tmp_path, kernels, first=True)
