# SPDX-License-Identifier: Apache-2.0
"""What keeps answers the same whatever order meshes stand in, taken out piece by piece: the tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "who comes back stands in its own order": (
        "left_out",
        [("occluders/world.py", "part.first_vertex, first, part.order)", "part.first_vertex, first, None)")],
    ),
    "vertices stay where they are": (
        "left_out",
        [("occluders/placing.py", "0 if order is None else order.ptr", "0")],
    ),
    "triangles stay where they are, and their numbers change": (
        "numbers",
        [("occluders/neighbours.py", "            if order is not None:", "            if False:")],
    ),
    "what is across an edge stays where it is": (
        "numbers",
        [("occluders/neighbours.py", "3 * stands[mine // 3] + mine % 3", "mine")],
    ),
    "other triangles keep the order": (
        "second_frame",
        [
            (
                "occluders/world.py",
                "kept = old if old is not None and old.topology == mesh.topology_revision else None",
                "kept = old",
            )
        ],
    ),
    "small things are in one cell": (
        "small_things",
        [("occluders/order.py", "for shift in (0, _BITS // 3):", "for shift in (_BITS // 3,):")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, "occluders/test_order.py", some, tmp_path, kernels, first=True)
