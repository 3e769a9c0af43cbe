# SPDX-License-Identifier: Apache-2.0
"""What keeps meshes that lights ignore out of masks, taken out piece by piece: tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_BVH = "accelerators/bvh/"
_MUTANTS: dict[str, list[Change]] = {
    "triangles that the light ignores": [(_BVH + "mask_walk.h", "filter.may &= casting;", "")],
    "what was left out before": [
        (_BVH + "scene_tree.py", "self._marked != marked", "(self._marked is None or self._marked[0] != marked[0])")
    ],
    "what the scene was before": [
        (_BVH + "scene_tree.py", "self._marked != marked", "(self._marked is None or self._marked[1] != marked[1])")
    ],
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    changes = _MUTANTS[mutant]
    assert failing_tests(changes, "../test_ignored_meshes.py", "trees_know and sah", tmp_path, kernels, first=True)
