# SPDX-License-Identifier: Apache-2.0
"""What keeps meshes that a light ignores apart from those of other lights, taken out piece by piece: their tests must
see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "records of whatever was left out": (
        "not_see and (brute or linear or packed)",
        [("occluders/seen.py", "self.scene.left_out,", "")],
    ),
    "boxes of whatever was left out": (
        "sequences and packed",
        [("occluders/clusters.py", "if self._left_out != scene.left_out:", "if False:")],
    ),
    "boxes that are followed once a frame": (
        "recorded and grid",
        [("engine/area_lights.py", "            band.follow()", "            pass")],
    ),
    "none comes back": (
        "not_see and (brute or linear or packed)",
        [("occluders/world.py", "not in gone and any(begin", "not in gone and not any(begin")],
    ),
    "left out for one batch with another": (
        "not_see and (brute or linear or packed)",
        [("visibility/light_points.py", " and self._ignored(end) == ignored", "")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, "../test_ignored_meshes.py", some, tmp_path, kernels, first=True)
