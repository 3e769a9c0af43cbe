# SPDX-License-Identifier: Apache-2.0
"""Proof that the node tests see: the package with one safeguard of the ray hierarchies taken away fails them."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_TREE, _CONES = "accelerators/cone_hierarchy/", "accelerators/paper_hierarchy/"

# the tests that have to fail; and file, what stands there, what is put there instead
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "half-angles from an arc cosine": (
        _CONES + "test_cone_nodes.py",
        [
            (
                _CONES + "cones.py",
                "2.0 * wp.atan2(wp.length(a - b), wp.length(a + b))",
                "wp.acos(wp.min(wp.dot(a, b), 1.0))",
            )
        ],
    ),
    "corners projected wherever they are": (
        _TREE + "test_box_nodes.py",
        [
            (
                "exact/faces.h",
                "bounded = Lanes::bits((front > 0x1p-18f * corners.reach) & corners.near());",
                "bounded = Lanes::ALL;",
            )
        ],
    ),
    "accepted by the edges alone": (
        _TREE + "test_box_nodes.py",
        [("exact/box.h", " & (middle[3] - reach[3] + far > plane)", "")],
    ),
    "no pads": (
        _TREE + "test_box_nodes.py",
        [
            ("exact/pads.h", "return 2.0f * error;", "return 0.0f * error;"),
            ("exact/pads.h", "return 7.0f * (slope + offset);", "return 0.0f * slope;"),
            (_TREE + "boxes.py", "_PAD = 2.0**-21", "_PAD = 0.0"),
        ],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_node_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    tests, changes = _MUTANTS[mutant]
    assert failing_tests(changes, tests, "", tmp_path, kernels, first=True)
