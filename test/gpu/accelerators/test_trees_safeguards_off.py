# SPDX-License-Identifier: Apache-2.0
"""What keeps trees over space exact, taken out piece by piece: their tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_KD, _OCTREE = "accelerators/kd_tree/planes.h", "accelerators/octree/octants.h"
_KD_SPLITS, _OCTREE_SPLITS = "accelerators/kd_tree/splitting.py", "accelerators/octree/splitting.py"
_PADDED: list[Change] = [("accelerators/segment.py", "padding = wp.float64(PADDING)", "padding = wp.float64(0.0)")]
_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "kd_tree: boxes without padding": ("tiny or planes", _PADDED),
    "kd_tree: a part that ends before the plane": ("tiny", [(_KD, "until = at;", "until = 0.999f * at;")]),
    "kd_tree: a part that begins behind the plane": (
        "planes or tiny",
        [(_KD, "now = until;", "now = 1.001f * until;")],
    ),
    "kd_tree: the farther child first": (
        "nearer",
        [
            (_KD, "forth ? low : low + 1", "forth ? low + 1 : low"),
            (_KD, "forth ? low + 1 : low;", "forth ? low : low + 1;"),
        ],
    ),
    "kd_tree: an end before the light": (
        "short_list",
        [(_KD, "until = segment.longest;", "until = 0.5f * segment.longest;")],
    ),
    "kd_tree: empty space is not cut off": (
        "empty_space",
        [
            (
                _KD_SPLITS,
                "if at > cell.lower[k] and at < cell.upper[k]:",
                "if j > 0 and j < bins and below > 0 and above > 0:",
            )
        ],
    ),
    "kd_tree: members of the lower child alone": (
        "members",
        [(_KD_SPLITS, "append(references, level, triangle, high)", "pass")],
    ),
    "kd_tree: members of one child alone at the plane": (
        "tiny",
        [(_KD_SPLITS, "        if is_low:\n", "        if is_low and along(upper, axis) > plane + 1.0e-5:\n")],
    ),
    "octree: boxes without padding": ("tiny or planes", _PADDED),
    "octree: planes that count as crossed too soon": (
        "short_list",
        [(_OCTREE, "cell.at[k] < now", "cell.at[k] < now + 0.01f")],
    ),
    "octree: the way down is not undone": ("short_list", [(_OCTREE, "-0.5f);", "0.5f);")]),
    "octree: directions are not mirrored": (
        "short_list",
        [(_OCTREE, "segment.direction[k] < 0.0f ? 1 << k : 0", "0")],
    ),
    "octree: an end before the light": (
        "short_list",
        [(_OCTREE, "until = segment.longest;", "until = 0.5f * segment.longest;")],
    ),
    "octree: members of the first child alone": (
        "members",
        [(_OCTREE_SPLITS, "append(references, level, triangle, here.octants[place, k])", "pass")],
    ),
    "octree: cells of twice the size": (
        "members",
        [(_OCTREE_SPLITS, "float(2 << level)", "float(1 << level)")],
    ),
    "kd_tree: a mailbox of another triangle": (
        "short_list",
        [("accelerators/mailboxes.h", "if (box == triangle)", "if (box >= 0)")],
    ),
    "octree: no mailboxes": ("mailboxes", [("accelerators/mailboxes.h", "if (box == triangle)", "if (false)")]),
    "octree: triangles of gaps are members": (
        "unlike",
        [("accelerators/references.py", "if lowers[i][0] >= OUTSIDE:", "if lowers[i][0] >= 2.0:")],
    ),
    "bsp: halves without a pad": ("meet_in_a_point", [("accelerators/bsp/splitting.py", "PAD = 1e-14", "PAD = 0.0")]),
    "bsp: the half of the sample alone": (
        "short_list",
        [("accelerators/bsp/halves.h", "if (in_first && in_last) {", "if (false) {")],
    ),
    "bsp: a part that ends before the plane": (
        "short_list",
        [("accelerators/bsp/halves.h", "a / (a - b) * (1.0 + BSP_PAD)", "a / (a - b) * 0.999")],
    ),
    "bsp: triangles in both halves in the lower one alone": (
        "short_list",
        [("accelerators/bsp/splitting.py", "append(references, level, triangle, high)", "pass")],
    ),
    "kd_tree: samples of any distance": (
        "far_away",
        [("accelerators/segment.h", "!(fabs(start[k]) <= FAR_AWAY)", "false")],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    some = f"{mutant.partition(':')[0]} and ({some})"
    failed = failing_tests(changes, "accelerators/test_trees.py", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
