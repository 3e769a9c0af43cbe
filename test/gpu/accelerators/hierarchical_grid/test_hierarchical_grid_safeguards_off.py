# SPDX-License-Identifier: Apache-2.0
"""What keeps the hierarchical grid exact, taken out piece by piece: its tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_WALK = "accelerators/hierarchical_grid/nested_cells.h"
_NESTING = "accelerators/hierarchical_grid/nesting.py"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "boxes without padding": (
        "tiny",
        [("accelerators/segment.py", "padding = wp.float64(PADDING)", "padding = wp.float64(0.0)")],
    ),
    "a mailbox of another triangle": ("short_list", [("accelerators/mailboxes.h", "box == triangle", "box >= 0")]),
    "no mailboxes": ("mailboxes", [("accelerators/mailboxes.h", "box == triangle", "false")]),
    "a grid left before its cell is": (
        "planes",
        [(_WALK, "at.next[axis] < at.until ? at.next[axis] : at.until", "0.9f * at.next[axis]")],
    ),
    "an end before the light": ("planes", [(_WALK, "enter(0, segment.longest)", "enter(0, 0.5f * segment.longest)")]),
    "grids entered where their cell is left": (
        "planes",
        [(_WALK, "segment.origin[k] + now * segment.direction[k]", "segment.origin[k] + until * segment.direction[k]")],
    ),
    "grids left through their border": (
        "planes",
        [
            (_WALK, "if (side == 0 || side == shape.count[k])", "if (false)"),
            (
                _WALK,
                "while (!(at.next[axis] <= at.until)) {",
                "while (!(at.next[axis] <= at.until) || at.cell[axis] + turn[axis] < 0 ||\n"
                "       at.cell[axis] + turn[axis] >= structure.grids.data[at.grid].shape.count[axis]) {",
            ),
        ],
    ),
    "a grid lies in the neighbour of its cell": (
        "planes",
        [
            (
                _NESTING,
                "wp.float64(at[k]) * wp.float64(outer.size[k])",
                "wp.float64(at[k] + 1) * wp.float64(outer.size[k])",
            )
        ],
    ),
    "samples of any distance": ("far_away", [("accelerators/segment.h", "!(fabs(start[k]) <= FAR_AWAY)", "false")]),
    "members of the first cell alone": (
        "members",
        [(_NESTING, "range(int(number_of(few)))", "range(int(wp.min(number_of(few), wp.int64(1))))")],
    ),
    "triangles of gaps are members": (
        "unlike",
        [("accelerators/cells.py", "if lower[0] >= OUTSIDE:", "if lower[0] >= 2.0:")],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, "accelerators/hierarchical_grid/test_hierarchical_grid.py", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
