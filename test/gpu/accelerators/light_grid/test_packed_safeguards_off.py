# SPDX-License-Identifier: Apache-2.0
"""Proof that the tests of tiles and boxes see: the package with one safeguard of `packed` taken away fails them, in
both of its forms."""

from __future__ import annotations

from pathlib import Path

import pytest
from mutants import failing_tests

_ROOT = Path(__file__).resolve().parents[4]
_GPU = "shadow_tracer/gpu"
_GRID = "accelerators/light_grid/"
_BOXES, _TILES, _CANDIDATES = "test_packed_boxes.py", "test_packed_tiles.py", "test_candidates.py"
_EXACT = "../../exact/test_blocks.py"
_TOGETHER, _KEPT = "test_together.py", "../../samples/test_kept_rays.py"
_PIECES, _SHARED = "test_pieces.py", "test_shared_positions.py"
_BOUNDS = ("low_u", "high_u", "low_v", "high_v")
_COVERED = "(middle[3] - reach[3] + far > plane)"

# the tests that have to fail and which of them are enough; and file, what stands there, what is put there instead
_MUTANTS: dict[str, tuple[str, str, list[tuple[str, str, str]]]] = {
    "pyramids without pads": (
        _CANDIDATES,
        "outermost",
        [(_GRID + "candidates.h", f"0x1p-20 * (1.0 + fabs({x}))", "0.0") for x in ("low", "high")],
    ),
    "the light lower than its rays": (
        _CANDIDATES,
        "all_around",
        [(_GRID + "candidates.h", "light < far[1] ? light - 0x1p-20 * fabs(light) : far[1]", "far[1]")],
    ),
    "bounds of the filter from half of the rays": (
        _PIECES,
        "those_of_brute_force",
        [(_GRID + "image16.h", "magnitudes.take(some & fits, U", "if (!half) magnitudes.take(some & fits, U")],
    ),
    "one bound for pieces however far rays are apart": (
        "../../test_far.py",
        "few_pixels and packed",
        [(_GRID + "magnitudes16.h", "apart ? wp::vec2(none, more) : ", "")],
    ),
    "bounds of the filter without W": (
        _PIECES,
        "those_of_brute_force",
        [(_GRID + "magnitudes16.h", "m + Lanes16::absolute(W)", "m")],
    ),
    "a face as far as its nearest ray": (
        _CANDIDATES,
        "all_around",
        [(_GRID + "pieces16.h", "far = farthest[j] > far ? farthest[j] : far;", "far = farthest[j];")],
    ),
    "rays outside of the tiles forgotten": (
        _CANDIDATES,
        "shown_everything",
        [(_GRID + "candidates.py", "if wild[1] > 0:", "if wild[1] > 1000000:")],
    ),
    "boxes kept when the scene changes": (
        _CANDIDATES,
        "only_what",
        [("occluders/clusters.py", "blocks(changed, CLUSTER * _BOXES, scene.triangle_count)", "()")],
    ),
    "records kept when the light moves": (
        _CANDIDATES,
        "shown_everything",
        [(_GRID + "candidates.py", "blocks(stale.triangles, BLOCK, self._scene.triangle_count)", "()")],
    ),
    "clusters on the first of their faces alone": (
        _TOGETHER,
        "clusters",
        [(_GRID + "candidates.h", "bits |= (seen[f] >> lane & 1)", "bits += (!bits && (seen[f] >> lane & 1))")],
    ),
    "sides that float64 cannot tell": (
        _EXACT,
        "records and nearly_flat and point",
        [("exact/sixteen.h", "return ~bits(sure | (permanent == none)) & Lanes8::ALL;", "return 0;")],
    ),
    "rays kept that those of further lights were written over": (
        _KEPT,
        "one_after_the_other",
        [("engine/band.py", "self._kept.forget()", "pass")],
    ),
    "clusters as wide as one of their triangles": (
        _TOGETHER,
        "clusters",
        [(_GRID + "together16.h", "side.high_u = -least(in ? -seen.high_u : far)", "side.high_u = seen.high_u[0]")],
    ),
    "clusters that begin where the last of their triangles does": (
        _TOGETHER,
        "clusters",
        [(_GRID + "together16.h", "-least(in ? -seen.nearest : far)", "least(in ? seen.nearest : far)")],
    ),
    "triangles without bounds among those with": (
        _TOGETHER,
        "across",
        [(_GRID + "together16.h", "some &= seen.bounded & Lanes16", "some &= Lanes16")],
    ),
    "tiles of a cluster where the last ray is": (
        _TOGETHER,
        "clusters",
        [(_GRID + "together16.h", "(slope * t0 + most(3", "(slope * box[80] + most(3")],
    ),
    "records written over while entries of them wait": (
        _TOGETHER,
        "clusters",
        [(_GRID + "entries.h", "+= flushes != flushed || entries.count.data[0] > waiting", "+= 0")],
    ),
    "records written over when there is no room for more": (
        _TOGETHER,
        "little_room",
        [(_GRID + "entries.h", "if (used == entries.clusters)\n            flush();", "used %= entries.clusters;")],
    ),
    "records written over that a full list left": (
        _TOGETHER,
        "clusters",
        [(_GRID + "entries.h", "flushes != flushed || entries", "entries")],
    ),
    "only the last rays of a tile that are found": (
        _TOGETHER,
        "clusters",
        [(_GRID + "entries.h", "entries.hidden.data[tile] |= (int)rays;", "entries.hidden.data[tile] = (int)rays;")],
    ),
    "rays that were found in the frame before": (
        _TOGETHER,
        "clusters",
        [(_GRID + "binning.py", "        entries.hidden[k] = 0\n", "")],
    ),
    "samples of a piece that are not side by side": (
        _PIECES,
        "brute_force",
        [(_GRID + "hidden.h", "return !__builtin_reduce_or(all ^ (lane + numbers[0]));", "return true;")],
    ),
    "eight states for one ray that is found": (
        _PIECES,
        "brute_force",
        [(_GRID + "hidden.h", "(bit & bits) != 0 ? shadowed : all", "bits != 0 ? shadowed : all")],
    ),
    "pieces on the first of their faces": (
        _PIECES,
        "brute_force",
        [(_GRID + "pieces16.h", "several = faces & (faces - 1) ||", "several =")],
    ),
    "pieces in the frustum without a look": (
        _SHARED,
        "frustum",
        [(_GRID + "pieces16.h", "if (Lanes16::bits(in & ~OnFace16::ahead(it.U, it.V, it.W)))", "if (piece < 0)")],
    ),
    "positions that steps do not tell apart": (
        _SHARED,
        "steps_do_not_tell and False",
        [(_GRID + "pieces.py", "_FLOOR, _FACTOR = 2.0**-8", "_FLOOR, _FACTOR = 0.0")],
    ),
    "rays with bounds of their own as if positions were exact": (
        _SHARED,
        "steps_do_not_tell and True",
        [(_GRID + "magnitudes16.h", "wp::vec2(none, more)", "wp::vec2(none, 0.0f)")],
    ),
    "rays of the pool as if positions were exact": (
        _PIECES,
        "brute_force",
        [
            (
                _GRID + "pool16.h",
                "magnitudes.store(tiles, piece, pieces.more.data[number / FACES]);",
                "magnitudes.store(tiles, piece);",
            )
        ],
    ),
    "bounds that do not grow with the bias": (
        _PIECES,
        "brute_force",
        [(_GRID + "aim16.h", " + (float)STEP_FACTOR * longest;", ";")],
    ),
    "positions nearer to the light than steps can tell": (
        _SHARED,
        "directions_of",
        [(_GRID + "aim16.h", "(size >= nearest) & (part <= most)", "part <= most")],
    ),
    "positions beyond the last step": (
        _SHARED,
        "far_beyond",
        [(_GRID + "shared16.h", "fits &= Doubles16::bits(Lanes16::absolute(at[k]) <= most);", "")],
    ),
    "other pieces than those that are left out": (
        _SHARED,
        "far_beyond",
        [(_GRID + "strip.h", "some.x += wide * from;", "")],
    ),
    "rays that begin behind the light": (
        _SHARED,
        "good_enough and behind",
        [
            (_GRID + "aim16.h", "(size >= nearest) & (part <= most)", "size >= nearest"),
            (_GRID + "shared16.h", "(step >= none) & (step <= largest)", "step >= none"),
        ],
    ),
    "a cone and a range that are not asked about": (
        _SHARED,
        "good_enough and (range or cone)",
        [(_GRID + "aim16.h", "(frame.cosine < -1.0 && frame.reach == HUGE_VAL)", "true")],
    ),
    "positions of the samples before": (
        _SHARED,
        "sequences",
        [(_GRID + "pieces.py", "look = samples.revision, samples.count", "look = samples.count")],
    ),
    "positions that are not kept taken by the next pass": (
        _SHARED,
        "sequences",
        [(_GRID + "pieces.py", "return not self._kept, True", "return False, True")],
    ),
    "positions kept where those of other pieces lie": (
        _SHARED,
        "sequences",
        [(_GRID + "shared16.h", "return kept ? strip.first : 0;", "return 0;")],
    ),
    "pieces before one beyond the frustum left in it": (
        _SHARED,
        "frustum",
        [(_GRID + "pieces16.h", "more(place, inverse != 0, first, pieces.turned.data[place], tiles, pieces);", "")],
    ),
    "halves that both have all rays": (
        _PIECES,
        "edges",
        [(_GRID + "pool16.h", "pieces.live.data[piece] & ~below;", "pieces.live.data[piece];")],
    ),
    "boxes of pieces of their first half": (
        _TILES,
        "test_one_light and frustum and sun",
        [
            (
                _GRID + "pieces16.h",
                "box.take(live(pieces, piece, half), at, at.depth(ray.Z, inverse));",
                "if (half == 0) box.take(live(pieces, piece, half), at, at.depth(ray.Z, inverse));",
            )
        ],
    ),
    "rows that end beyond the last sample": (
        _PIECES,
        "in_rows or sequences",
        [(_GRID + "strip.h", "n < there ? n : there", "n")],
    ),
    "points that are taken for those before": (
        _PIECES,
        "in_rows",
        [(_GRID + "pieces.py", "if self._looked != samples.revision:", "if self._looked < 0:")],
    ),
    "halves beyond the room for them": (
        _PIECES,
        "no_room",
        [(_GRID + "pool16.h", "if (other >= pieces.room)", "if (other < 0)")],
    ),
    "boxes without pads": (
        _TILES,
        "test_one_light and frustum and sun",
        [(_GRID + "tiles.py", "TILE_PAD = 2.0**-20", "TILE_PAD = 0.0")],
    ),
    "edges without pads": (
        _BOXES,
        "beside",
        [("exact/pads.h", "return 2.0f * error;", "return 0.0f * error;")],
    ),
    "planes without pads": (
        _BOXES,
        "vast-0",
        [("exact/pads.h", "return 7.0f * (slope + offset);", "return 0.0f * slope;")],
    ),
    "bounds without pads": (
        _BOXES,
        "between",
        [("exact/faces.h", f"0x1p-20f * (1.0f + Corners::size_of({x}))", "0.0f") for x in _BOUNDS],
    ),
    "depths without pads, of triangles and boxes": (
        _BOXES,
        "corners",
        [
            ("exact/faces.h", "near + 0x1p-18f * (1.0f + Corners::size_of(near))", "near"),
            (_GRID + "tile_box.h", "low[2] - depth_pad * fabsf(low[2])", "low[2]"),
        ],
    ),
    "faces told apart without a margin": (
        _BOXES,
        "between",
        [("exact/faces.h", " - 0x1p-20f * reach;", ";")],
    ),
    "corners projected wherever they are": (
        _BOXES,
        "inside-0",
        [("exact/faces.h", "Lanes::bits((front > 0x1p-18f * corners.reach) & corners.near())", "Lanes::ALL")],
    ),
    "covered by the edges alone": (
        _BOXES,
        "sun-0",
        [("exact/box.h", f" & {_COVERED}", "")],
    ),
    "covered without pads": (
        _BOXES,
        "beside or vast",
        [
            *(
                ("exact/box.h", f"(middle[{k}] - reach[{k}] > edge)", f"(middle[{k}] - reach[{k}] > 0.0f)")
                for k in range(3)
            ),
            ("exact/box.h", _COVERED, _COVERED.replace("plane", "0.0f")),
        ],
    ),
    "pads that do not grow with the depth": (
        _BOXES,
        "near",
        [(_GRID + "side.h", "6.0f + 2.001f * (s0 > s1 ? s0 : s1)", "6.0f")],
    ),
    "covered where the nearest ray is": (
        _BOXES,
        "sun-0",
        [(_GRID + "side.h", "slope * t1", "slope * t0")],
    ),
    "columns looked up by their middles": (
        _BOXES,
        "sun-0",
        [
            (_GRID + "tiles.py", "tiles.columns[box] - tiles.columns[box + 32]", "tiles.columns[box]"),
            (_GRID + "tiles.py", "tiles.columns[box] + tiles.columns[box + 32]", "tiles.columns[box]"),
            (_GRID + "packing.py", "lookup_cell(middle + extent, fit)", "lookup_cell(middle, fit)"),
            (_GRID + "packing.py", "lookup_cell(middle - extent, fit)", "lookup_cell(middle, fit)"),
        ],
    ),
}


# What only the CUDA form has: file, what stands there, what is put there instead.
_OF_WARPS: dict[str, tuple[str, str, str]] = {
    "of two columns the first alone": (_GRID + "binning.h", "rest ? base + Warp::lowest(rest) : -1", "-1"),
    "of two blocks the first alone": (
        _GRID + "binning.h",
        "rest ? block_of(group, first, second, Warp::lowest(rest)) : -1",
        "-1",
    ),
    "32 columns of many": (_GRID + "binning.h", "base <= to; base += 32", "base == from; base += 32"),
    "long triangles taken by none": (_GRID + "binning.py", "bins.length_of[unit + lane] == LONG", "False"),
    "items and the triangle itself": (_GRID + "binning.h", "bins.length_of.data[unit] = IN_ITEMS;", ""),
    "the last columns in no item": (_GRID + "binning.h", "(last - from + ITEM_COLUMNS)", "(last - from + 1)"),
    "chunks in the first part alone": (_GRID + "tracing.py", "bins.item_count[NEXT_TO_TRACE] = 0", "pass"),
    "items in the first part alone": (_GRID + "tracing.py", "bins.item_count[NEXT_TO_EMIT] = 0", "pass"),
}


@pytest.mark.slow
@pytest.mark.parametrize("mutant", _OF_WARPS)
def test_without_a_safeguard_of_warps_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    some = "that_warps_take"
    failing_tests([_OF_WARPS[mutant]], "accelerators/light_grid/test_packed_entries.py", some, tmp_path, kernels)


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("mutant", _MUTANTS)
def test_without_a_safeguard_the_tests_fail(mutant: str, tmp_path: Path, kernels: Path) -> None:
    tests, some, changes = _MUTANTS[mutant]
    failed = failing_tests(changes, f"accelerators/light_grid/{tests}", f"({some}) and not decide", tmp_path, kernels)
    in_cuda_form = ["cuda_form" in line for line in failed]
    only_wide = tests in (_CANDIDATES, _TOGETHER, _KEPT, _EXACT, _PIECES, _SHARED) or "pieces" in mutant
    if not only_wide:
        assert any(in_cuda_form) and not all(in_cuda_form), f"one of the forms does not see it: {failed}"
