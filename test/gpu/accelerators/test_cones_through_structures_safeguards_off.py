# SPDX-License-Identifier: Apache-2.0
"""What lets cones through a k-d tree miss nothing, taken out piece by piece: the tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_TESTS, _WALK, _LINES = "test_cones_through_structures.py", "kd_tree/cone_walk.h", "half_lines.h"
_MUTANTS: dict[str, tuple[str, str, str, str]] = {
    "what does not wait": ("answers", _WALK, "if (in_low && in_high) {", "if (in_low && in_high && number < 8) {"),
    "the lower child by the axis alone": (
        "answers and few",
        _LINES,
        "minus[k] = steep(Arithmetic::sub(way[k], Arithmetic::add(aside, lean)));",
        "minus[k] = steep(way[k]);",
    ),
    "cones around an axis as those beside it": (
        "answers and few",
        _LINES,
        "const double slope = along(minus, axis), t",
        "const double slope = Arithmetic::absolute(along(minus, axis)), t",
    ),
    "parts of the other child": (
        "answers",
        _WALK,
        "in = to_low ? low_in : high_in;",
        "in = to_low ? high_in : low_in;",
    ),
    "what waits by where the cone leaves it": (
        "answers",
        _WALK,
        "if (Arithmetic::mul(ins[top], unit) > wanted)",
        "if (Arithmetic::mul(outs[top], unit) > wanted)",
    ),
    "lists cut by where the cone comes in": (
        "pieces",
        _WALK,
        "Arithmetic::mul(to, unit) >= after",
        "Arithmetic::mul(from, unit) >= after",
    ),
    "triangles twice": ("pieces", "cone_hits.h", "if (numbers[k - 1] == number)", "if (false)"),
    "a mailbox of another triangle": ("answers", "mailboxes.h", "if (box == triangle)", "if (box >= 0)"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(_MUTANTS))
def test_its_tests_see_it(name: str, tmp_path: Path, kernels: Path) -> None:
    some, header, old, new = _MUTANTS[name]
    change: Change = (f"accelerators/{header}", old, new)
    assert failing_tests([change], f"accelerators/{_TESTS}", some, tmp_path, kernels, first=True)
