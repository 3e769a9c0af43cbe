# SPDX-License-Identifier: Apache-2.0
"""What keeps closest hits the same through every walker, taken out piece by piece: the tests must see it, in both
forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_CLOSEST = "visibility/closest.h"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "depths as if they were exact": (
        "edge_on",
        [(_CLOSEST, "(depth(triangle, d) + asked.slack.data[0])", "depth(triangle, d)")],
    ),
    "rays that end before the hit": ("views", [(_CLOSEST, "reach = (depth", "reach = 0.9 * (depth")]),
    "depth in place of distance": ("views", [(_CLOSEST, " * norm(d[0], d[1], d[2])", "")]),
    "rays that never end": ("behind", [(_CLOSEST, "return metres < HUGE_VAL", "return false")]),
    "triangles that nobody sees": (
        "nobody",
        [(_CLOSEST, "CameraRecord::at(seen.records, triangle)[CameraRecord::CASTS] == 0.0f || ", "")],
    ),
    "the last of equal depths": ("ties", [("exact/hit.h", "mine == before && triangle < other", "mine == before")]),
    "cameras at any distance": ("far_away", [("accelerators/segment.h", "!(fabs(start[k]) <= FAR_AWAY)", "false")]),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, "visibility/test_closest.py", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
