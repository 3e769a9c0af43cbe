# SPDX-License-Identifier: Apache-2.0
"""What keeps the tree over blocks exact, taken out piece by piece: its tests must see it, in the forms that have it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_BVH = "accelerators/bvh/"
_USUAL, _CUDA, _BOTH = (True, False), (False, True), (True, True)
_MUTANTS: dict[str, tuple[str, tuple[bool, bool], list[Change]]] = {
    "boxes without padding": (
        "tiny",
        _BOTH,
        [
            (_BVH + "refit.h", "(low[k] - BOX_PADDING)", "(low[k])"),
            (_BVH + "refit.h", "(high[k] + BOX_PADDING)", "(high[k])"),
        ],
    ),
    "blocks without a band": (
        "tiny or edges",
        _USUAL,
        [(_BVH + "bvh.py", "BLOCK_BAND=2.0**-17", "BLOCK_BAND=2.0**-30")],
    ),
    "one side of triangles": (
        "answers",
        _USUAL,
        [(_BVH + "block.h", "(low >= -most) | (high <= most)", "low >= -most")],
    ),
    "a bundle's triangles as one ray's": (
        "packets",
        _USUAL,
        [(_BVH + "descent.h", "1.001f * beside", "0.0f * beside")],
    ),
    "a bundle's boxes as one ray's": (
        "packets",
        _USUAL,
        [
            (_BVH + "descent.h", "above(origin[0] + beside, origin[1] + beside, origin[2] + beside)", "above(origin)"),
            (_BVH + "descent.h", "below(origin[0] - beside, origin[1] - beside, origin[2] - beside)", "below(origin)"),
        ],
    ),
    "a bundle by its ends alone": (
        "beginnings",
        _USUAL,
        [(_BVH + "packets.h", "spread = square > spread ? square : spread", "spread = square")],
    ),
    "a bundle by its beginnings alone": (
        "ends",
        _USUAL,
        [(_BVH + "packets.h", "spread = square > spread ? square : spread", "spread = side ? spread : square")],
    ),
    "bundles left early are not cut": (
        "many_blocks",
        _USUAL,
        [(_BVH + "descent.h", "return false;\n            if (link", "return true;\n            if (link")],
    ),
    "samples of any distance": (
        "far_away",
        _BOTH,
        [
            (_BVH + "packets.h", "bits(near) != Lanes16::ALL", "false"),
            ("accelerators/segment.h", "!(fabs(start[k]) <= FAR_AWAY)", "false"),
        ],
    ),
    "a tile takes the place of rays that wait": (
        "any_size",
        _USUAL,
        [("visibility/any_hit.h", "int all = taken == 0;", "int all = 1;")],
    ),
    "columns beside the tiles are those of tiles": (
        "any_size",
        _USUAL,
        [("accelerators/walker.h", "+ tiled / SIDE + (k - tiled)", "+ (k - tiled)")],
    ),
    "wide nodes are not refitted": (
        "refitted",
        _USUAL,
        [(_BVH + "build.py", "self._launch(refit_wide_nodes, 1, [self.tree])", "pass")],
    ),
    "parents are refitted before their children": (
        "refitted",
        _CUDA,
        [(_BVH + "build.py", "reversed(range(self._levels))", "range(self._levels)")],
    ),
    "other triangles in the blocks of those before": (
        "come_and_go",
        _BOTH,
        [(_BVH + "scene_tree.py", "and made_for.topology == scene.revision.topology", "")],
    ),
    "nothing behind a second child": (
        "answers",
        _BOTH,
        [(_BVH + "build.py", "tree.escapes[second] = tree.escapes[node]", "tree.escapes[second] = -1")],
    ),
    "blocks of any number of triangles": (
        "every_triangle",
        _BOTH,
        [
            (_BVH + "build.h", "if (!enough(left, count))", "if (left <= 0 || left >= count)"),
            (_BVH + "build.h", "if (cost < least && enough(within, count)) {", "if (cost < least) {"),
        ],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, forms, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, "accelerators/bvh/test_bvh.py", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert (not all(in_cuda_form), any(in_cuda_form)) == forms, f"not in the forms that have it: {failed}"
