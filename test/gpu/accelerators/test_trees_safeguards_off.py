# SPDX-License-Identifier: Apache-2.0
"""What keeps trees over space exact, taken out piece by piece, of several trees at a time: the tests of each must see
it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_KD, _OCTREE, _BSP = (f"accelerators/{name}.h" for name in ("kd_tree/planes", "octree/octants", "bsp/halves"))
_KD_SPLITS, _OCTREE_SPLITS, _BSP_SPLITS = (f"accelerators/{name}/splitting.py" for name in ("kd_tree", "octree", "bsp"))
_ALL = ("kd_tree", "octree", "bsp")
_END = ("until = segment.longest;", "until = 0.5f * segment.longest;")

# What is taken out of a tree, the tests of it that see that, and the changes.
Mutant = tuple[str, str, list[Change]]
_ROUNDS: list[dict[str, Mutant]] = [
    {
        "kd_tree": (
            "boxes with next to no padding",  # without any width they would be in no child at all
            "tiny or planes",
            [("accelerators/segment.py", "padding = wp.float64(PADDING)", "padding = wp.float64(0.02 * PADDING)")],
        ),
        # Not the octree: a box without any width in the middle of a cell would be in none of its octants.
        "bsp": ("parts without a pad", "meet_in_a_point", [(_BSP_SPLITS, "PAD = 1e-14", "PAD = 0.0")]),
    },
    {
        "kd_tree": ("a part that ends before the plane", "tiny", [(_KD, "until = at;", "until = 0.999f * at;")]),
        "octree": (
            "planes that count as crossed too soon",
            "short_list",
            [(_OCTREE, "cell.at[k] < now", "cell.at[k] < now + 0.01f")],
        ),
        "bsp": (
            "a part that ends before the plane",
            "short_list",
            [(_BSP, "a / (a - b) * (1.0 + BSP_PAD)", "a / (a - b) * 0.999")],
        ),
    },
    {
        "kd_tree": (
            "a part that begins behind the plane",
            "planes or tiny",
            [(_KD, "now = until;", "now = 1.001f * until;")],
        ),
        "octree": ("the way down is not undone", "short_list", [(_OCTREE, "-0.5f);", "0.5f);")]),
        "bsp": ("the half of the sample alone", "short_list", [(_BSP, "if (in_first && in_last) {", "if (false) {")]),
    },
    {
        "kd_tree": (
            "the farther child first",
            "nearer",
            [
                (_KD, "forth ? low : low + 1", "forth ? low + 1 : low"),
                (_KD, "forth ? low + 1 : low;", "forth ? low : low + 1;"),
            ],
        ),
        "octree": (
            "directions are not mirrored",
            "short_list",
            [(_OCTREE, "segment.direction[k] < 0.0f ? 1 << k : 0", "0")],
        ),
    },
    {
        "kd_tree": ("an end before the light", "short_list", [(_KD, *_END)]),
        "octree": ("an end before the light", "short_list", [(_OCTREE, *_END)]),
        "bsp": ("an end before the light", "planes_that_hold", [(_BSP, "{ 0.0, 1.0 }", "{ 0.0, 0.1 }")]),
    },
    {
        "kd_tree": (
            "empty space is not cut off",
            "empty_space",
            [
                (
                    _KD_SPLITS,
                    "if at > cell.lower[k] and at < cell.upper[k]:",
                    "if j > 0 and j < bins and below > 0 and above > 0:",
                )
            ],
        ),
        "octree": ("cells of twice the size", "members", [(_OCTREE_SPLITS, "float(2 << level)", "float(1 << level)")]),
    },
    {
        "kd_tree": (
            "members of the lower child alone",
            "members",
            [("accelerators/references.py", "append(growth, level, growth.triangle[r], high)", "pass")],
        ),
        "octree": (
            "members of the first child alone",
            "members",
            [(_OCTREE_SPLITS, "append(growth, level, triangle, here.octants[place, k])", "pass")],
        ),
        "bsp": ("members of the lower half alone", "short_list", []),
    },
    {
        "kd_tree": (
            "members of one child alone at the plane",
            "tiny",
            [
                (
                    _KD_SPLITS,
                    "is_low = along(lower, axis) < plane",
                    "is_low = along(lower, axis) < plane and not (0.0 < along(upper, axis) - plane < 1.0e-5)",
                )
            ],
        ),
    },
    {
        name: (
            "a mailbox of another triangle",
            "short_list",
            [("accelerators/mailboxes.h", "if (box == triangle)", "if (box >= 0)")] if name == _ALL[0] else [],
        )
        for name in _ALL
    },
    {
        "kd_tree": ("no mailboxes", "once", [("accelerators/mailboxes.h", "if (box == triangle)", "if (false)")]),
        "octree": ("no mailboxes", "once", []),
    },
    {
        name: (
            "triangles of gaps are members",
            "unlike",
            [("accelerators/references.py", "boxes_lower[i][0] >= OUTSIDE:", "boxes_lower[i][0] >= 2.0:")]
            if name == _ALL[0]
            else [],
        )
        for name in _ALL
    },
    {
        "kd_tree": (
            "samples of any distance",
            "far_away",
            [("accelerators/segment.h", "!(fabs(start[k]) <= FAR_AWAY)", "false")],
        ),
        "octree": ("samples of any distance", "far_away", []),
    },
]


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("trees", _ROUNDS, ids=lambda trees: "; ".join(f"{name}, {trees[name][0]}" for name in trees))
def test_without_a_safeguard_the_tests_fail(trees: dict[str, Mutant], tmp_path: Path, kernels: Path) -> None:
    some = " or ".join(f"({name} and ({tests}))" for name, (_, tests, _) in trees.items())
    changes = [change for _, _, changes in trees.values() for change in changes]
    failed = failing_tests(changes, "accelerators/test_trees.py", some, tmp_path, kernels)
    for name in trees:
        in_cuda_form = ["cuda_form" in line for line in failed if f"{name}" in line.partition("[")[2]]
        assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms of {name} does not see it: {failed}"
