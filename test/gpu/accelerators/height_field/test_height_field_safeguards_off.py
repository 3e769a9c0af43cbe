# SPDX-License-Identifier: Apache-2.0
"""What keeps height fields and their sweep exact, taken out piece by piece: their tests must see it, in both forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import Change, failing_tests

_ROOM = "accelerators/height_field/"
_RAY, _PROFILE, _SWEEP = _ROOM + "chart_ray.h", _ROOM + "profile.h", _ROOM + "sweep.h"
_LOOK = _ROOM + "first_look.h"
_NODES, _CHARTS = _ROOM + "nodes.h", _ROOM + "charts.py"
_FIELD, _SWEPT, _KEPT = "test_height_field.py", "test_sweep.py", "test_kept.py"
_EDGES, _IN_PLACE, _SIGNS = "test_open_edges.py", "visibility/in_place.h", "visibility/signs.h"
_PACKETS, _BUNDLE = "test_packets.py", _ROOM + "bundle.h"
_PLANES = _ROOM + "quad_planes.h"
_DEPTH, _BIASED = "test_depth_charts.py", "test_biased_start.py"


_MUTANTS: dict[str, tuple[str, str, list[Change]]] = {
    "boxes without padding": (
        _FIELD,
        "corners_of_boxes or rows_columns or plane",
        [
            (_RAY, "(k == 2 ? pad[k] : 0.5f + pad[k]) *", "(k == 2 ? 0.0f : 0.5f) *"),
            (_BUNDLE, "ray.begin[k] : none) + ray.pad[k];", "ray.begin[k] : none);"),
            (_BUNDLE, "-ray.begin[k] : none) - ray.pad[k];", "-ray.begin[k] : none);"),
            (_NODES, "floorf(low - (float)CHART_ROUNDED)", "ceilf(low)"),
            (_NODES, "ceilf(high + (float)CHART_ROUNDED)", "floorf(high)"),
        ],
    ),
    "positions are in their places": (
        _FIELD,
        "beside_their_places",
        [
            (
                _RAY,
                "(double)(rows > columns ? rows : columns) + beside);",
                "(double)(rows > columns ? rows : columns));",
            ),
            (
                _RAY,
                "(double)(rows > columns ? rows : columns) + beside) * 1.0001",
                "(double)(rows > columns ? rows : columns))",
            ),
        ],
    ),
    "samples of any distance": (
        _FIELD,
        "far_away or lost",
        [
            (_RAY, "beside < 1.0e29 &&", "true &&"),
            (_RAY, "(Lanes::ALL & ~Doubles::bits(weight <= 0x1p20)) |", ""),
        ],
    ),
    "rays end before the light": (
        _FIELD,
        "terrain",
        [(_RAY, "bounded ? 1.0f : 0.0f", "bounded ? 2.0f : 1.0f")],
    ),
    "rays begin behind their bias": (
        _BIASED,
        "at_the_bias",
        [(_RAY, "Lanes::inverse(root(sum)) * (1.0f - 0x1p-12f)", "Lanes::inverse(root(sum)) * (1.0f + 0x1p-12f)")],
    ),
    "rays begin far behind their bias": (
        _BIASED,
        "biases",
        [(_RAY, "Lanes::inverse(root(sum)) * (1.0f - 0x1p-12f)", "Lanes::inverse(root(sum)) * 1.1f")],
    ),
    "the way to the sun has length one": (
        _BIASED,
        "any_length",
        [(_RAY, "Lanes::inverse(root(sum)) * (1.0f - 0x1p-12f)", "(1.0f - 0x1p-12f)")],
    ),
    "rays leave the chart too early": (
        _FIELD,
        "corners_of_boxes or sizes or terrain",
        [(_RAY, "Lanes::inverse(rate) * (1.0f + 0x1p-12f)", "Lanes::inverse(rate) * (1.0f - 0x1p-9f)")],
    ),
    "rays enter the chart too late": (
        _FIELD,
        "corners_of_boxes or sizes or terrain",
        [(_RAY, "Lanes::inverse(grows) * (1.0f - 0x1p-12f)", "Lanes::inverse(grows) * (1.0f + 0x1p-9f)")],
    ),
    "a part of a long way is short": (
        _FIELD,
        "very_far",
        [(_RAY, "if (meets & Lanes::bits(comes > begin_at)) {", "if (false) {")],
    ),
    "segments behind the camera": (
        _DEPTH,
        "very_near",
        [(_RAY, "in_front(chart, at, way, from, to);", "(void)least;")],
    ),
    "sizes that float32 does not hold": (
        _DEPTH,
        "sizes_of_all_kinds",
        [(_RAY, "chart.nearest > 1.0e-20 && chart.nearest < 1.0e20 && size < 1.0e30", "true")],
    ),
    "nodes without their last row": (_DEPTH, "steps", [(_NODES, "larger(high[r], high[r + 1])", "high[r]")]),
    "a bundle begins where its first ray does": (
        _PACKETS,
        "usual_form",
        [
            (_BUNDLE, "above[k] = largest(some ? ray.begin[k] : none)", "above[k] = ray.begin[k][0]"),
            (_BUNDLE, "below[k] = -largest(some ? -ray.begin[k] : none)", "below[k] = ray.begin[k][0]"),
        ],
    ),
    "a bundle goes where its first ray does": (
        _PACKETS,
        "usual_form",
        [
            (_BUNDLE, "most[k] = largest(some ? ray.span[k] : none);", "most[k] = ray.span[k][0];"),
            (_BUNDLE, "least[k] = -largest(some ? -ray.span[k] : none);", "least[k] = ray.span[k][0];"),
        ],
    ),
    "all rays of a bundle go one way": (
        _PACKETS,
        "usual_form",
        [(_BUNDLE, "if (least[k] > 0.0f)", "if (most[k] > 0.0f)")],
    ),
    "a packet is done when one ray is": (
        _PACKETS,
        "usual_form",
        [(_ROOM + "packets.h", "if (!(lanes & query.asking))", "if (lanes & ~query.asking)")],
    ),
    "all rays of a tile ask": (
        _PACKETS,
        "usual_form and images",
        [(_IN_PLACE, "all &= asked.states.data[numbers[j]] == LIT;", "")],
    ),
    "a tile takes the place of rays that wait": (
        _PACKETS,
        "usual_form and images",
        [(_IN_PLACE, "!looked && taken == 0", "!looked")],
    ),
    "rays far apart are the first one": (
        _PACKETS,
        "usual_form",
        [(_ROOM + "packets.h", "const int one = lanes & -lanes;", "const int one = 1;")],
    ),
    "a bundle begins at the node of its rays' begins": (
        _PACKETS,
        "usual_form",
        [
            (_BUNDLE, "(least[k] < 0.0f ? 1.001f * least[k] : 0.0f)", "0.0f"),
            (_BUNDLE, "(most[k] > 0.0f ? 1.001f * most[k] : 0.0f)", "0.0f"),
        ],
    ),
    "quads are flat": (
        _PACKETS,
        "usual_form",
        [(_PLANES, "0.25f * Lanes16::absolute(bottom - top) + ray.pad[2]", "ray.pad[2]")],
    ),
    "planes of quads without padding": (
        _FIELD,
        "usual_form and (corners_of_boxes or rows_columns or plane)",
        [(_PLANES, " + ray.pad[2]", ""), (_PLANES, "ray.pad[0] *", "0.0f *")],
    ),
    "planes of quads in their places": (
        _FIELD,
        "usual_form and slopes_beside",
        [(_PLANES, "ray.pad[0] *", "0.0f *")],
    ),
    "above at one end": (
        _PACKETS,
        "usual_form",
        [(_PLANES, "(first > pad) & (last > pad)", "(first > pad) | (last > pad)")],
    ),
    "one triangle of a quad": (
        _FIELD,
        "sizes",
        [(_ROOM + "at_chart.h", "k < 2; ++k", "k < 1; ++k")],
    ),
    "children of the last node alone": (
        _FIELD,
        "sizes or terrain",
        [(_NODES, "r < rows && c < columns", "r + 1 < rows && c < columns")],
    ),
    "charts of surfaces as they were": (
        _FIELD,
        "sequences",
        [(_CHARTS, "if each.key not in before:", "if number >= len(before):")],
    ),
    "meshes aside are not looked at": (
        _FIELD,
        "beside_terrain",
        [("accelerators/surfaces.py", "self._rest.follow(others)", "self._rest.follow([])")],
    ),
    "meshes aside are shown no rays": (
        _FIELD,
        "beside_terrain",
        [("accelerators/surfaces.py", "return self._rest.triangle_count > 0", "return False")],
    ),
    "lamps shine on all samples": (
        _FIELD,
        "beside_terrain or terrain",
        [("samples/states.h", "frame.light[3] == 0.0 ? sun(", "true ? sun(")],
    ),
    "pairs of meshes named as those of the scene": (
        _FIELD,
        "beside_terrain and cuda_form",
        [
            (
                "accelerators/union.py",
                "if self._waiting is not None:\n            context",
                "if False:\n            context",
            )
        ],
    ),
    "heights of the first triangle of a quad": (_DEPTH, "steps or other", [(_NODES, "j < 6", "j < 3")]),
    "one triangle makes a whole quad": (
        _DEPTH,
        "steps or lies_at",
        [(_NODES, " && triangles.data[number + 1][0] != GAP_VERTEX", "")],
    ),
    "no triangle has a corner at the camera": (
        _DEPTH,
        "lies_at_the_camera",
        [(_NODES, "lost |= !(h == h);", ""), (_NODES, "lost |= corners(", "corners(")],
    ),
    "no triangle is nearly seen edge-on": (
        _DEPTH,
        "edge_on",
        [(_ROOM + "silent_row.h", "(float)(pad * scale)", "0.0f")],
    ),
    "triangles of one diagonal alone are seen edge-on": (
        _DEPTH,
        "edge_on",
        [(_ROOM + "silent_row.h", "if (both)", "if (false)")],
    ),
    "a lamp is a sun": (_DEPTH, "edge_on", [(_ROOM + "silent_row.h", "(float)(at.d * scale)", "0.0f")]),
    "the chart of the whole image at every step": (
        _DEPTH,
        "steps",
        [("../scene/chart.py", "[0.0, camera.fy, camera.cy]]) / step", "[0.0, camera.fy, camera.cy]])")],
    ),
    "lit above what a band has of lines alone": (
        _SWEPT,
        "between_two_lines",
        [(_SWEEP, "strip ? larger(edges, most) : corners", "strip ? most : corners")],
    ),
    "lit above what is whole": (
        _SWEPT,
        "suns or hole",
        [(_SWEEP, "strip ? larger(edges, most) : corners", "larger(edges, most)")],
    ),
    "diagonals of bands as if nothing were mirrored": (
        _SWEPT,
        "between_two_lines or suns",
        [(_SWEEP, "if (sweep.mirrored)", "if (false)")],
    ),
    "a stretch without its last line": (
        _SWEPT,
        "stretches",
        [(_SWEEP, "stretch = whole ? most : corners;", "stretch = -infinity;")],
    ),
    "a stretch is a line": (
        _SWEPT,
        "stretches",
        [(_SWEEP, "stretch = larger(here_and_on, stretch);", "stretch = here_and_on;")],
    ),
    "stretches begin on any line": (
        _SWEPT,
        "stretches",
        [(_PROFILE, " & (stretch == down(stretch))", "")],
    ),
    "hidden by what is behind": (
        _SWEPT,
        "suns or stretches",
        [(_PROFILE, "bounded(active & (x == line) & (side != 0.0), line);", "bounded(active, line);")],
    ),
    "a strip is whole where quads are missing": (
        _SWEPT,
        "hole or suns",
        [
            (_SWEEP, "above = strip ? above : -infinity;", ""),
            (_SWEEP, "below = strip ? below : infinity;", ""),
        ],
    ),
    "nothing before the line matters": (
        _SWEPT,
        "suns or biases",
        [(_PROFILE, "there & clear & (level >", "there & (level >")],
    ),
    "no diagonals": (_SWEPT, "suns or every_way", [(_PROFILE, "some & (one * two < 0.0)", "some & 0")]),
    "diagonals as if nothing were mirrored": (
        _SWEPT,
        "suns or every_way",
        [
            (_PROFILE, "const Number one = sweep.mirrored ?", "const Number one = false ?"),
            (_PROFILE, "two = sweep.mirrored ?", "two = false ?"),
        ],
    ),
    "nothing is too near to call": (_SWEPT, "stairs or suns", [(_ROOM + "sweep.py", "_PAD = 2.0**-6", "_PAD = 0.0")]),
    "below is as good as above": (
        _SWEPT,
        "suns",
        [(_PROFILE, "(side > 0.0) & (level < gather(", "(side * side >= 0.0) & (level < gather(")],
    ),
    "every sample at a corner is the corner": (
        _SWEPT,
        "suns",
        [(_PROFILE, "const bool same =", "const bool same = true ||")],
    ),
    "the bias does not matter": (
        _SWEPT,
        "biases",
        [
            (_PROFILE, "from = biased ? x + sample[3] * sweep.per_metre + 0x1p-20 : x;", "from = x;"),
        ],
    ),
    "what leaves along the border is gone": (
        _SWEPT,
        "suns or stairs",
        [(_PROFILE, "(fabs(sweep.drift) >= 0.5 ? out & clear : out & 0)", "out")],
    ),
    "swept with positions out of place": (
        _SWEPT,
        "out_of_place",
        [(_LOOK, "!(structure.beside.data[number] <= SWEEP_BESIDE)", "false")],
    ),
    "a ray meets the surface where quads are missing": (
        _SWEPT,
        "beside_a_border",
        [
            (_PROFILE, "there = sum == sum;", "there = true;"),
            (_PROFILE, "first >= 0 && last < sweep.across;", "true;"),
        ],
    ),
    "one chart is as good as all": (
        _SWEPT,
        "second_terrain",
        [(_LOOK, "structure.count == 1 ? 2 : 1", "2")],
    ),
    "what passed in the frame before": (
        _SWEPT,
        "suns",
        [
            (
                _LOOK,
                "asked.passed.data[rays[j]] = lit >> j & 1 ? passes : 0;",
                "if (lit >> j & 1) asked.passed.data[rays[j]] = passes;",
            )
        ],
    ),
    "points that do not ask": (
        _SWEPT,
        "invalid",
        [(_LOOK, "(asked.states.data[ray] == LIT)", "true")],
    ),
    "a larger bias than there is": (
        _SWEPT,
        "biases",
        [(_SIGNS, "0.99999999 * bias", "2.0 * bias")],
    ),
    "edges that float64 is sure of": (
        _SWEPT,
        "stairs or way_that",
        [(_SIGNS, "MASK_PAD * way.sum()", "0.0")],
    ),
    "an edge is left open": (
        _EDGES,
        "ridges and usual_form and height_field",
        [(_IN_PLACE, "while ((asking >> lane & 1) && opens[lane] > 0)", "while (false)")],
    ),
    "any two edges are one": (
        _EDGES,
        "ridges and usual_form and height_field",
        [(_IN_PLACE, "if (left[k].from == now.to && left[k].to == now.from)", "if (true)")],
    ),
    "edges have no direction": (
        _EDGES,
        "ridges and usual_form and height_field",
        [
            (
                _IN_PLACE,
                "if (left[k].from == now.to && left[k].to == now.from)",
                "if (left[k].from + left[k].to == now.to + now.from)",
            )
        ],
    ),
    "more open edges than there is room for": (
        _EDGES,
        "many_open and usual_form and height_field",
        [(_IN_PLACE, "decide(left[--opens[lane]].triangle);", "--opens[lane];")],
    ),
    "all triangles are seen from one side": (
        _EDGES,
        "ridges",
        [(_IN_PLACE, "turn = own.there > 0.0 ? one : -one", "turn = one")],
    ),
    "an edge that is met is passed": (
        _EDGES,
        "ridges",
        [(_SIGNS, "turn * value > off + IN_PLACE_LEAST", "value == value")],
    ),
    "certain whatever the bias": (
        _BIASED,
        "at_the_bias",
        [(_SIGNS, "behind * length >= 1.00000001 * bias * front", "behind == behind")],
    ),
    "certain of front faces": (
        _FIELD,
        "terrain",
        [(_IN_PLACE, "if (asked.cull != 0)\n", "if (false)\n")],
    ),
    "a sweep is kept whatever becomes of the surface": (
        _SWEPT,
        "same_sun",
        [(_ROOM + "sweep.py", "made_for = (*largest.key, *towards)", "made_for = (*towards,)")],
    ),
    "columns of the surface as it was": (
        _KEPT,
        "any_order",
        [(_ROOM + "sweep.py", "if self._turned_for == placed.key:", "if self._turned_for is not None:")],
    ),
    "columns are kept when all is to be made once more": (
        _KEPT,
        "damaged",
        [(_ROOM + "sweep.py", "self._made_for = self._turned_for = None\n", "self._made_for = None\n")],
    ),
    "a sweep is kept when all is to be made once more": (
        _KEPT,
        "damaged",
        [(_ROOM + "height_field.py", "        self._sweeps.forget()\n", "")],
    ),
    "front faces may be culled": (
        _SWEPT,
        "nothing_is_swept",
        [(_ROOM + "sweep.py", "if cull or towards", "if towards")],
    ),
}


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    tests, some, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, f"accelerators/height_field/{tests}", some, tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    assert "usual_form" in some or any(in_cuda_form), f"the form of CUDA does not see it: {failed}"
    assert "cuda_form" in some or not all(in_cuda_form), f"the wide form does not see it: {failed}"
