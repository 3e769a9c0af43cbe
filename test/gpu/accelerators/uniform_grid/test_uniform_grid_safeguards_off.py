# SPDX-License-Identifier: Apache-2.0
"""What keeps the uniform grid exact, taken out piece by piece: its tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_GRID = "accelerators/uniform_grid/"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "boxes without padding": (
        "tiny",
        [("accelerators/segment.py", "padding = wp.float64(PADDING)", "padding = wp.float64(0.0)")],
    ),
    "a mailbox of another triangle": ("mailboxes", [("accelerators/mailboxes.h", "box == triangle", "box >= 0")]),
    "no mailboxes": ("mailboxes", [("accelerators/mailboxes.h", "box == triangle", "false")]),
    "an end before the light": (
        "planes",
        [(_GRID + "cells.h", "next[axis] <= segment.longest", "next[axis] <= 0.5f * segment.longest")],
    ),
    "samples of any distance": ("far_away", [("accelerators/segment.h", "!(fabs(start[k]) <= FAR_AWAY)", "false")]),
    "members of the first cell alone": (
        "members",
        [
            (
                _GRID + "uniform_grid.py",
                "range(cells.first[0], cells.last[0] + 1)",
                "range(cells.first[0], cells.first[0] + 1)",
            )
        ],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, "accelerators/uniform_grid/test_uniform_grid.py", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
