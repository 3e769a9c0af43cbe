# SPDX-License-Identifier: Apache-2.0
"""What keeps meshes that a light ignores, or that cast no shadows, apart from others, taken out piece by piece: their
tests must see it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "records of whatever was left out": (
        "not_see and (brute or linear or packed)",
        [("occluders/seen.py", "self.front_face_culling, self.scene.left_out", "self.front_face_culling")],
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
        [("visibility/light_points.py", "self._kind(end) == kind", "self._kind(end)[1:] == kind[1:]")],
    ),
}


# Of meshes that cast nothing in any light.
_SILENT: dict[str, tuple[str, list[Change]]] = {
    "they are occluders as well": (
        "frames_between and brute",
        [
            (
                "occluders/world.py",
                "scene.occluders if isinstance(scene, Scene) and not self._ordered else scene",
                "scene",
            )
        ],
    ),
    "depth cameras do not see them": (
        "is_seen",
        [("occluders/world.py", "isinstance(scene, Scene) and not self._ordered", "isinstance(scene, Scene)")],
    ),
    "which they are is found once": (
        "frames_between and brute",
        [
            (
                "../scene/mesh.py",
                "self._occluders is None or self._occluders.revision != self._revision",
                "self._occluders is None",
            )
        ],
    ),
    "numbers are counted through the others": (
        "cones_pass",
        [("../scene/some.py", "numbers - self._own[mesh] + self._whole[mesh]", "numbers")],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    assert failing_tests(changes, "../test_ignored_meshes.py", some, tmp_path, kernels, first=True)


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _SILENT)
def test_without_a_safeguard_what_casts_nothing_is_seen_to(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _SILENT[mutant]
    assert failing_tests(changes, "../test_cast_shadows.py", some, tmp_path, kernels, first=True)
