# SPDX-License-Identifier: Apache-2.0
"""What keeps the classification of rays exact, taken out piece by piece: its tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_RAYS = "accelerators/ray_classification/"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "boxes without padding": (
        "borders",
        [("accelerators/segment.py", "padding = wp.float64(PADDING)", "padding = wp.float64(0.0)")],
    ),
    "beams from the middle of the origins": (
        "few_triangles",
        [
            (
                _RAYS + "classify.py",
                "size = wp.vec3(half_origin, half_origin, half_origin)",
                "size = wp.vec3(0.0, 0.0, 0.0)",
            )
        ],
    ),
    "beams of half the directions": (
        "few_triangles or unlike",
        [(_RAYS + "classify.py", "least = u - half", "least = u")],
    ),
    "beams that go one way": (
        "few_triangles or unlike or borders",
        [(_RAYS + "classify.py", "back = beam.face % 2 == 1", "back = False")],
    ),
    "a child in the place of another": (
        "few_triangles or unlike",
        [(_RAYS + "place.h", "origin[k] >= middle[k] ? 1 << k : 0", "origin[k] < middle[k] ? 1 << k : 0")],
    ),
    "lists of another scene": (
        "unlike",
        [
            (
                _RAYS + "ray_classification.py",
                "self.forget_lists(always=True)",
                "self.forget_lists(always=self._made_for is None)",
            )
        ],
    ),
    "a list that does not fit is cut off": (
        "memory",
        [(_RAYS + "classify.py", "                few = count\n", "")],
    ),
    "nothing is forgotten": (
        "forgotten",
        [
            (
                _RAYS + "classify.py",
                "return always != 0 or (tree.used[2] != 0 and tree.used[3] == 0)",
                "return always != 0",
            )
        ],
    ),
    "every ray asks for a cell": (
        "asked_for",
        [(_RAYS + "ask.h", "if (*child != 0 || wp::atomic_add(child, -1) != 0)", "if (wp::atomic_add(child, -1) > 0)")],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    tests = "accelerators/ray_classification/test_ray_classification.py"
    failed = failing_tests(changes, tests, some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
