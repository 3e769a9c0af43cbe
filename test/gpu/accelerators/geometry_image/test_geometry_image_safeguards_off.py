# SPDX-License-Identifier: Apache-2.0
"""What keeps geometry images exact, taken out piece by piece: their tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_ROOM = "accelerators/geometry_image/"
_ORDER, _BOX, _NODES, _WALK = _ROOM + "order.h", _ROOM + "quad_box.h", _ROOM + "node_box.h", _ROOM + "threaded.h"
_QUAD, _IMAGES = _ROOM + "quad.h", _ROOM + "images.py"

_MUTANTS: dict[str, tuple[str, list[Change]]] = {
    "boxes without padding": (
        "corners_of_boxes or in_their_plane or rows_columns",
        [
            (_BOX, "box.inverse_extent - BOX_PADDING", "box.inverse_extent"),
            (_BOX, "box.inverse_extent + BOX_PADDING", "box.inverse_extent"),
        ],
    ),
    "what is not a number is in boxes": (
        "some_corners or nodes_are",
        [(_BOX, "if (!wp::isfinite(at))\n                    continue;\n", "")],
    ),
    "quads with three corners are none": ("some_corners", [(_BOX, "valid >= 3", "valid == 4")]),
    "quads are looked at from one side of the diagonal": (
        "folded",
        [(_QUAD, "query.tests += 2 -", "possible &= across.value > 0.0 ? 1 : 2;\n            query.tests += 2 -")],
    ),
    "the diagonal seen from the same side twice": ("terrain", [(_QUAD, "across.back()", "across")]),
    "one triangle of a quad": ("terrain", [(_QUAD, "k < 2", "k < 1")]),
    "edges that float64 is sure of": (
        "no_cracks or rows_columns",
        [("visibility/signs.h", "MASK_PAD * way.sum() * plane.size", "0.0")],
    ),
    "the last children are left out": ("terrain or sizes", [(_NODES, "child < count", "child + 1 < count")]),
    "empty nodes are in their parents": (
        "nodes_are",
        [(_NODES, "if (!Node::some(node))\n                continue;\n", "")],
    ),
    "siblings are passed by": (
        "terrain",
        [(_WALK, "            ++key;\n", "            key = (key | 3) + 1;\n")],
    ),
    "tiles follow each other along rows": ("sizes", [(_ORDER, "row = image.upright ? j : i", "row = i")]),
    "samples of any distance": ("far_away", [(_WALK, "if (place == Segment::TOO_FAR)", "if (false)")]),
    "boxes of surfaces as they were": (
        "sequences",
        [
            (
                _IMAGES,
                "revisions = mesh.topology_revision, mesh.vertices_revision, mesh.pose_revision",
                "revisions = (0,)",
            )
        ],
    ),
    "boxes stay where they were": (
        "sequences",
        [(_IMAGES, "(mesh.name, *revisions, first_vertex, node)", "(mesh.name, *revisions)")],
    ),
    "the scene's box is that of the first frame": (
        "sequences",
        [(_IMAGES, "if held is None or not holds(held, low, high):", "if held is None:")],
    ),
    "boxes are kept when all is to be made once more": (
        "damaged",
        [(_ROOM + "geometry_image.py", "        self._images.forget()\n", "")],
    ),
    "silent triangles of meshes alone": (
        "terrain or wild",
        [(_ROOM + "geometry_image.py", "rest[0] + counted[1][0]", "rest[0]")],
    ),
    "silent triangles are counted once": (
        "sequences or folded",
        [(_ROOM + "geometry_image.py", "if counted is None or counted[0] != key:", "if counted is None:")],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, "accelerators/geometry_image/test_geometry_image.py", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert any(in_cuda_form), f"the form of CUDA does not see it: {failed}"
    assert not all(in_cuda_form), f"the wide form does not see it: {failed}"
