# SPDX-License-Identifier: Apache-2.0
"""What keeps the light buffer exact, taken out piece by piece: its tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_BUFFER = "accelerators/light_buffer/"
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "bounds without a pad": (
        "tiny",
        [
            ("exact/faces.h", "low_u -= 0x1p-20f * (1.0f + Corners::size_of(low_u));", ""),
            ("exact/faces.h", "high_u += 0x1p-20f * (1.0f + Corners::size_of(high_u));", ""),
        ],
    ),
    "members of the first column alone": (
        "tiny or outwards",
        [(_BUFFER + "on_cube.h", "column <= at.last_column", "column <= at.first_column")],
    ),
    "lists of faces are not shown": (
        "outwards",
        [
            (
                _BUFFER + "directions.h",
                "|| show(structure, LightCells::of_face(at.face, columns), depth, hint, query)",
                "",
            )
        ],
    ),
    "lists that are not sorted": ("outwards", [(_BUFFER + "heap.h", "sink(member, depth, 0, end);", "")]),
    "the farthest first": (
        "outwards or unlike",
        [(_BUFFER + "heap.h", "depths[i] < depths[j] ||", "depths[i] > depths[j] ||")],
    ),
    "rays end too soon": (
        "outwards",
        [(_BUFFER + "directions.h", "structure.depths.data[k] < depth", "structure.depths.data[k] < depth + 0.3f")],
    ),
    "rays do not end": (
        "not_tested",
        [(_BUFFER + "directions.h", "structure.depths.data[k] < depth", "false")],
    ),
    "the last occluder is believed": (
        "last",
        [
            (
                _BUFFER + "directions.h",
                "hint < query.triangle_count() && query.visit(hint))",
                "hint < query.triangle_count())",
            )
        ],
    ),
    "the last occluder is not tried": (
        "last",
        [(_BUFFER + "directions.h", "const int hint = last;", "const int hint = -1;")],
    ),
    "cells of another light": (
        "unlike",
        [(_BUFFER + "light_buffer.py", "if key == self._made:", "if key[:1] == self._made[:1]:")],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    tests = "accelerators/light_buffer/test_light_buffer.py"
    failed = failing_tests(changes, tests, some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
