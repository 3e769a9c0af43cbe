# SPDX-License-Identifier: Apache-2.0
"""What keeps answers about few points and triangles right, taken out piece by piece: the tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_PAIRS = "visibility/every_pair.h"

_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "another point is decided about": (
        "own_answer",
        [(_PAIRS, "const Three& at = point[number[ray]];", "const Three& at = point[ray];")],
    ),
    "another point is hidden": (
        "own_answer",
        [(_PAIRS, "state[number[begin + __builtin_ctz(hidden)]]", "state[begin + __builtin_ctz(hidden)]")],
    ),
    "another triangle is decided about": (
        "own_answer",
        [(_PAIRS, "hides(first + t,", "hides(t,")],
    ),
    "what is not certain hides": (
        "own_answer",
        [(_PAIRS, "if (!hides(first + t, begin + j))", "if (false)")],
    ),
    "points that a light does not shine on are asked about": (
        "bits_of_brute_force and 513-17",
        [(_PAIRS, "there[16 * group + j] << j", "1 << j")],
    ),
    "nothing is culled": (
        "bits_of_brute_force and 513-17",
        [(_PAIRS, "records, cull, 0, silent", "records, 0, 0, silent")],
    ),
    "the light of the call before": (
        "bits_of_brute_force and 513-17",
        [("visibility/few_pairs.py", "if light is self._known:", "if self._known is not None:")],
    ),
    "points that are no numbers are asked about": (
        "who_is_asked",
        [("engine/engine.py", "if valid is not None or not self._asks_few", "if not self._asks_few")],
    ),
    "what a light ignores hides": (
        "who_is_asked",
        [("visibility/few_pairs.py", "light.ignore or isinstance", "isinstance")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, "visibility/test_few_pairs.py", some, tmp_path, kernels, first=True)
