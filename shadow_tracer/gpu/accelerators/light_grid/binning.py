# SPDX-License-Identifier: Apache-2.0
"""Triangles into tiles and tiles traced on CUDA; ``binning_wide.py`` does the same on the CPU.

Entries are counted, scanned, and emitted, so that each has a running number that says whether it belongs to the part at
hand: of a part, no more entries than the list holds. A triangle that may touch many columns is not left to one thread:
it becomes items of a few columns each. Emitted entries are brought together by tile (counted on the way, scanned,
scattered); lists longer than 256 are cut into chunks. A warp's 32 lanes, one ray each, take a chunk at a time; all of
them read the same record. Answers may be stored by several warps: storing is idempotent.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.tile_test import SIDE
from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.exact.faces import TRIANGLE, Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, space_of
from shadow_tracer.gpu.visibility.answers import Answers

# Columns of an item, and columns from which on a triangle becomes items.
_ITEM_COLUMNS = 4
_MANY_COLUMNS = 8


@wp.struct
class Bins:
    """Lists between triangles and tiles."""

    capacity: int  # entries
    items: wp.array(dtype=wp.vec4i)  # of large triangles: triangle of the pass, face, first and last column
    item_count: wp.array(dtype=int)
    itemised: wp.array(dtype=int)  # of each triangle: faces that became items, as bits
    offsets: wp.array(dtype=wp.int64)  # inclusive sums of entries, by triangle, then by item
    tile: wp.array(dtype=int)  # of each entry
    record: wp.array(dtype=int)
    rank: wp.array(dtype=int)  # within its tile
    length: wp.array(dtype=int)  # entries of each tile
    start: wp.array(dtype=int)  # exclusive sums of them
    total: wp.array(dtype=int)  # the same over all parts
    chunks: wp.array(dtype=int)  # exclusive sums of each tile's chunks
    sorted: wp.array(dtype=int)  # records, tile by tile
    work: wp.array(dtype=wp.vec2i)  # tile and number of the chunk in it
    emitted: wp.array(dtype=int)


# One triangle and one thread. Tests as in tile_test.SIDE_SIXTEEN, a box at a time. The sink gets tiles that take an
# entry; `cover` those that need none.
_THREAD = (
    TRIANGLE
    + SIDE
    + r"""
    const bool aligned = tiles.aligned.data[place] != 0;
    const int* groups = tiles.groups.data;
    wp::int64 nodes = 0;
    Planes it;
    auto box1 = [&](const float* boxes, int number, const Side& s, bool& covered) -> bool {
        const float* b = boxes + 96 * (size_t)(number >> 4) + (number & 15);
        const float cu = b[0], cv = b[16], eu = b[32], ev = b[48], t0 = b[64], t1 = b[80];
        covered = false;
        ++nodes;
        if (!(cu - eu <= s.u1 && cu + eu >= s.u0 && cv - ev <= s.v1 && cv + ev >= s.v0 && t0 <= s.nearest))
            return false;
        if (s.blind)
            return eu >= 0.0f;
        const float m = 6.0f + 2.001f * (fabsf(t0) > fabsf(t1) ? fabsf(t0) : fabsf(t1));
        const float edge = s.edge * m, plane = s.plane * m;
        bool all = true;
        for (int k = 0; k < 3; ++k) {
            const float c = s.a[k] * cu + s.b[k] * cv + s.c[k], r = s.ra[k] * eu + s.rb[k] * ev;
            if (!(c + r >= -edge))
                return false;
            all = all && c - r > edge;
        }
        const float g = s.pa * cu + s.pb * cv + s.pc, h = s.rpa * eu + s.rpb * ev;
        if (!(g + h + s.pt * t0 >= -plane))
            return false;
        covered = all && g - h + s.pt * t1 > plane;
        return true;
    };
    auto cover = [&](int first, int count) {
        for (int tile = first; tile < first + count; ++tile)
            tiles.covered.data[tile] = 1;
    };
    // The side of a triangle on a face; false if it cannot touch the face.
    auto side_of = [&](int triangle, int face, Side& side) -> bool {
        const int group = 6 * place + face;
        if (groups[6 * group + 1] == 0)
            return false;
        wp::vec4 at[3];
        const float size = corners_of(triangle, place * corners_per_light, at);
        if (!aligned && !(touched_by(at, size) >> face & 1))
            return false;
        Seen seen;
        seen.bounded = false;
        if (size < far_out) {
            if (aligned && most3(at[0][2], at[1][2], at[2][2]) < -0x1p-18f * size)
                return false;
            if (!look(at[0], at[1], at[2], size, face, seen))
                return false;
        }
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        if (seen.bounded) {
            const wp::vec4 grid = tiles.fit.data[group];
            if (seen.high[first] < grid[0] || seen.high[second] < grid[1]
                || (seen.low[first] - grid[0]) * grid[2] > 4100.0f || (seen.low[second] - grid[1]) * grid[3] > 4100.0f)
                return false;
        }
        const size_t record = (size_t)place * occluders.count + triangle;
        if (!load((const wp::vec4*)occluders.records.data + 4 * record, it))
            return false;
        side = turn(it, face);
        if (seen.bounded) {
            side.bounded = true;
            side.u0 = seen.low[first], side.u1 = seen.high[first];
            side.v0 = seen.low[second], side.v1 = seen.high[second];
            side.nearest = seen.nearest;
        }
        return true;
    };
    // First and last column of a group that the side may touch.
    auto columns_of = [&](int group, const Side& side, int& from, int& to) {
        const wp::vec4 grid = tiles.fit.data[group];
        auto cell = [&](float u) -> int {
            const float x = (u - grid[0]) * grid[2] * 0.0625f;
            return (int)(x > 0.0f ? (x < 255.0f ? x : 255.0f) : 0.0f);
        };
        from = tiles.lookup.data[256 * (size_t)group + cell(side.u0)][0];
        to = tiles.lookup.data[256 * (size_t)group + cell(side.u1)][1];
    };
    auto visit = [&](const Side& side, int group, int from, int to, auto sink) {
        const int *of = groups + 6 * group, length = of[2] / 512, first = of[3], first_block = of[5];
        const int all_blocks = (of[1] + 511) / 512;
        bool covered;
        for (int column = from; column <= to; ++column) {
            if (!box1(tiles.columns.data, first + column, side, covered))
                continue;
            const int block0 = column * length;
            const int blocks = all_blocks - block0 < length ? all_blocks - block0 : length;
            if (covered) {
                cover(16 * (first_block + block0), 16 * blocks);
                continue;
            }
            for (int b = 0; b < blocks; ++b) {
                const int block = first_block + block0 + b;
                if (!box1(tiles.blocks.data, 16 * (first + column) + b, side, covered))
                    continue;
                if (covered) {
                    cover(16 * block, 16);
                    continue;
                }
                for (int k = 0; k < 16; ++k) {
                    if (!box1(tiles.boxes.data, 16 * block + k, side, covered))
                        continue;
                    if (covered)
                        cover(16 * block + k, 1);
                    else
                        sink(16 * block + k);
                }
            }
        }
    };
"""
)

# Entries of what one thread does: emitted from number `before` on as far as they belong to the window, or just counted.
_SINK = r"""
    wp::int64 number = before;
    auto sink = [&](int tile) {
        const wp::int64 at = number++ - window;
        if (emit == 0 || at < 0 || at >= bins.capacity)
            return;
        bins.tile.data[at] = tile;
        bins.record.data[at] = place * occluders.count + triangle;
        bins.rank.data[at] = wp::atomic_add(&bins.length.data[tile], 1);
    };
"""

_COUNTED = r"""
    if (emit == 0 && nodes > 0)
        wp::atomic_add(answers.counters.data + answers.counters.shape[1] * (triangle & 63) + nodes_visited, nodes);
    return number - before;
"""


@wp.func_native(
    _THREAD
    + f"const int item_columns = {_ITEM_COLUMNS}, many_columns = {_MANY_COLUMNS};\n"
    + r"""
    int faces_out = 0;
    for (int face = 0; face < 6; ++face) {
        Side side;
        if (!side_of(triangle, face, side))
            continue;
        int from, to;
        columns_of(6 * place + face, side, from, to);
        if (to - from + 1 <= many_columns)
            continue;
        const int n = (to - from + item_columns) / item_columns, room = bins.items.shape[0];
        // As long as it does not fit, a thread takes all of the triangle by itself. The counter stays below room + n.
        if (bins.item_count.data[0] > room - n)
            continue;
        const int slot = wp::atomic_add(&bins.item_count.data[0], n);
        if (slot + n > room) {
            // Too late: what is left of the room holds nothing.
            for (int k = slot; k < room; ++k)
                bins.items.data[k] = wp::vec4i(0, 0, 0, -1);
            continue;
        }
        for (int k = 0; k < n; ++k) {
            const int first = from + item_columns * k, last = first + item_columns - 1;
            const int number = place * occluders.count + triangle;
            bins.items.data[slot + k] = wp::vec4i(number, face, first, last < to ? last : to);
        }
        faces_out |= 1 << face;
    }
    bins.itemised.data[(size_t)place * occluders.count + triangle] = faces_out;
    """
)
def itemise(
    triangle: int,
    place: int,
    corners_per_light: int,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Make items of a triangle that may touch many columns."""
    ...


@wp.func_native(
    _THREAD
    + _SINK
    + r"""
    const int out = bins.itemised.data[(size_t)place * occluders.count + triangle];
    for (int face = 0; face < 6; ++face) {
        Side side;
        if (out >> face & 1 || !side_of(triangle, face, side))
            continue;
        int from, to;
        columns_of(6 * place + face, side, from, to);
        visit(side, 6 * place + face, from, to, sink);
    }
    """
    + _COUNTED
)
def bin_triangle(
    triangle: int,
    place: int,
    corners_per_light: int,
    emit: int,
    before: wp.int64,
    window: wp.int64,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
) -> wp.int64:
    """The entries of a triangle that did not become items: how many, and with ``emit`` they are stored."""
    ...


@wp.func_native(
    _THREAD
    + _SINK
    + r"""
    Side side;
    if (side_of(triangle, face, side))
        visit(side, 6 * place + face, first_column, last_column, sink);
    """
    + _COUNTED
)
def bin_item(
    triangle: int,
    place: int,
    face: int,
    first_column: int,
    last_column: int,
    corners_per_light: int,
    emit: int,
    before: wp.int64,
    window: wp.int64,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
) -> wp.int64:
    """The same for an item."""
    ...


@wp.kernel(enable_backward=False)
def itemise_triangles(
    lights: wp.array(dtype=LightFrame), vertices: int, tiles: Tiles, occluders: Occluders, bins: Bins, answers: Answers
):
    """One thread per triangle of each light."""
    i = wp.tid()
    place = i // occluders.count
    itemise(i - place * occluders.count, place, vertices, space_of(lights[place]), tiles, occluders, bins, answers)


@wp.func
def before_of(bins: Bins, i: int) -> wp.int64:
    """Number of the first entry of triangle, or item, ``i``."""
    if i == 0:
        return wp.int64(0)
    return bins.offsets[i - 1]


@wp.kernel(enable_backward=False)
def bin_triangles(
    lights: wp.array(dtype=LightFrame),
    vertices: int,
    emit: int,
    window: wp.int64,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Count (into ``bins.offsets``) or emit the entries of triangles: one thread each."""
    i = wp.tid()
    place = i // occluders.count
    before = wp.int64(0)
    if emit != 0:
        before = before_of(bins, i)
        if bins.offsets[i] <= before or bins.offsets[i] <= window or before >= window + wp.int64(bins.capacity):
            return
    space = space_of(lights[place])
    found = bin_triangle(
        i - place * occluders.count, place, vertices, emit, before, window, space, tiles, occluders, bins, answers
    )
    if emit == 0:
        bins.offsets[i] = found


@wp.kernel(enable_backward=False)
def bin_items(
    lights: wp.array(dtype=LightFrame),
    vertices: int,
    emit: int,
    window: wp.int64,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Count or emit the entries of items: one thread per place for one."""
    k = wp.tid()
    i = tiles.lights * occluders.count + k
    item = wp.vec4i(0, 0, 0, -1)
    if k < wp.min(bins.item_count[0], bins.items.shape[0]):
        item = bins.items[k]
    before = wp.int64(0)
    if emit == 0:
        bins.offsets[i] = wp.int64(0)
    else:
        before = before_of(bins, i)
        if bins.offsets[i] <= before or bins.offsets[i] <= window or before >= window + wp.int64(bins.capacity):
            return
    if item[3] < item[2]:
        return
    place = item[0] // occluders.count
    space = space_of(lights[place])
    found = bin_item(
        item[0] - place * occluders.count,
        place,
        item[1],
        item[2],
        item[3],
        vertices,
        emit,
        before,
        window,
        space,
        tiles,
        occluders,
        bins,
        answers,
    )
    if emit == 0:
        bins.offsets[i] = found
