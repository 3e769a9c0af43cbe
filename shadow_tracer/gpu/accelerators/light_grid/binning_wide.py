# SPDX-License-Identifier: Apache-2.0
"""Triangles into tiles and tiles traced, sixteen boxes or rays at a time, for the CPU. ``binning.py`` does the same on
CUDA.

Triangles are taken in order, those that may concern any ray (``candidates.py``). (Tile, triangle) entries gather in a
list of limited length; whenever it is full, it is sorted by tile and traced, tile by tile: the rays of a tile stay in
registers while its triangles pass by. A limit far below all entries has two advantages: the list stays in the cache,
and tiles that are finished take no more entries.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.front_wide import BOUNDS, TAKE
from shadow_tracer.gpu.accelerators.light_grid.tile_test import SIDE_SIXTEEN
from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.device.counters import ENTRIES, LARGEST_TILE, OVERFLOWS, PASSES
from shadow_tracer.gpu.exact.decision import FILTER_SIXTEEN
from shadow_tracer.gpu.exact.faces import TRIANGLE, Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, space_of
from shadow_tracer.gpu.exact.records import BLOCK
from shadow_tracer.gpu.visibility.answers import Answers


@wp.struct
class EntryList:
    """Entries gathered between two tracings."""

    capacity: int
    bounded: int  # whether the capacity is smaller than it would be without a bound
    tile: wp.array(dtype=int)
    record: wp.array(dtype=int)
    sorted: wp.array(dtype=int)
    start: wp.array(dtype=int)  # per tile
    total: wp.array(dtype=int)  # entries of each tile so far
    count: wp.array(dtype=int)  # [entries waiting, traces]


# Expects `tiles`, `list`, `space`, `occluders` and `answers`; `first_record` of the light's triangles, `place` of the
# light. Traces what is in the list.
_TRACE = (
    FILTER_SIXTEEN
    + r"""
    wp::int64 tests = 0, accepted = 0;
    auto gone = [&](int tile) {
        float* box = tiles.boxes.data + 96 * (size_t)(tile / 16) + tile % 16;
        box[32] = box[48] = -1.0e30f;
    };
    auto shadow = [&](int tile, unsigned rays) {
        for (; rays; rays &= rays - 1)
            answers.states.data[tiles.order.data[32 * (size_t)tile + __builtin_ctz(rays)]] = 1;
    };
    auto test_tile = [&](int tile, const int* records, int n) {
        unsigned live = (unsigned)tiles.live.data[tile];
        const float* rays = tiles.rays.data + 160 * (size_t)tile;
        for (int k = 0; k < n && live; ++k) {
            const float* record = (const float*)occluders.records.data + 16 * (size_t)records[k];
            if (k + 4 < n)
                __builtin_prefetch((const float*)occluders.records.data + 16 * (size_t)records[k + 4]);
            tests += __builtin_popcount(live);
            int yes_low = 0, yes_high = 0;
            const unsigned low = live & 0xFFFF ? filter16(record, rays, yes_low) : 0;
            const unsigned high = live >> 16 ? filter16(record, rays + 80, yes_high) : 0;
            const unsigned found = (low | high << 16) & live;
            if (!found)
                continue;
            const unsigned yes = ((low ? yes_low : 0) | (high ? (unsigned)yes_high << 16 : 0)) & found;
            for (unsigned maybe = found & ~yes; maybe; maybe &= maybe - 1)
                settle(tiles.order.data[32 * (size_t)tile + __builtin_ctz(maybe)], records[k] % occluders.count);
            if (yes) {
                shadow(tile, yes);
                live &= ~yes;
            }
        }
        if (live != (unsigned)tiles.live.data[tile]) {
            tiles.live.data[tile] = (int)live;
            if (!live)
                gone(tile);
        }
    };
    auto flush = [&]() {
        const int n = list.count.data[0], slots = 16 * tiles.counts.data[2];
        if (n == 0)
            return;
        list.count.data[0] = 0;
        ++list.count.data[1];
        if (n < slots / 8) {
            // Sorting costs more than it gains.
            for (int k = 0; k < n; ++k) {
                ++list.total.data[list.tile.data[k]];
                test_tile(list.tile.data[k], list.record.data + k, 1);
            }
            return;
        }
        int* start = list.start.data;
        for (int k = 0; k <= slots; ++k)
            start[k] = 0;
        for (int k = 0; k < n; ++k)
            ++start[list.tile.data[k]];
        int sum = 0;
        for (int k = 0; k < slots; ++k) {
            const int here = start[k];
            start[k] = sum;
            sum += here;
        }
        for (int k = 0; k < n; ++k)
            list.sorted.data[start[list.tile.data[k]]++] = list.record.data[k];
        int from = 0;
        for (int tile = 0; tile < slots; ++tile) {
            const int to = start[tile];
            if (to > from) {
                list.total.data[tile] += to - from;
                test_tile(tile, list.sorted.data + from, to - from);
            }
            from = to;
        }
    };
    auto accept = [&](int tile) {
        const unsigned live = (unsigned)tiles.live.data[tile];
        if (!live)
            return;
        ++accepted;
        shadow(tile, live);
        tiles.live.data[tile] = 0;
        gone(tile);
    };
    auto report = [&]() {
        wp::int64* counter = answers.counters.data;
        wp::atomic_add(counter + leaf_tests, tests);
        wp::atomic_add(counter + accepted_nodes, accepted);
    };
"""
)

_BIN = (
    TRIANGLE
    + _TRACE
    + "const bool aligned = tiles.aligned.data[place] != 0;\n"
    + BOUNDS
    + SIDE_SIXTEEN
    + TAKE
    + r"""
    wp::int64 nodes = 0, entries = 0;
    const int* groups = tiles.groups.data;
    auto enter = [&](int tile, int record) {
        if (list.count.data[0] == list.capacity) {
            flush();
            if (!tiles.live.data[tile])
                return;
        }
        const int slot = list.count.data[0]++;
        list.tile.data[slot] = tile;
        list.record.data[slot] = record;
        ++entries;
    };
    auto visit_block = [&](const Side& side, int block, int record) {
        int full = 0;
        int hit = meets(tiles.boxes.data + 96 * (size_t)block, side, full);
        nodes += 16;
        for (int left = full; left; left &= left - 1)
            accept(16 * block + __builtin_ctz(left));
        hit &= ~full;
        const int n = __builtin_popcount(hit), waiting = list.count.data[0];
        if (waiting + n > list.capacity) {
            for (; hit; hit &= hit - 1)
                enter(16 * block + __builtin_ctz(hit), record);
            return;
        }
        int *to_tile = list.tile.data + waiting, *to_record = list.record.data + waiting;
        for (; hit; hit &= hit - 1) {
            *to_tile++ = 16 * block + __builtin_ctz(hit);
            *to_record++ = record;
        }
        list.count.data[0] = waiting + n;
        entries += n;
    };
    auto visit = [&](const Side& side, int group, int record) {
        const int *of = groups + 6 * group, length = of[2] / 512, first = of[3], first_block = of[5];
        const wp::vec4 grid = tiles.fit.data[group];
        auto cell = [&](float u) -> int {
            const float x = (u - grid[0]) * grid[2] * 0.0625f;
            return (int)(x > 0.0f ? (x < 255.0f ? x : 255.0f) : 0.0f);
        };
        const int from = tiles.lookup.data[256 * (size_t)group + cell(side.u0)][0];
        const int to = tiles.lookup.data[256 * (size_t)group + cell(side.u1)][1];
        if (side.bounded && to - from < 4) {
            // A triangle that touches few columns is small: its bounds say nearly all.
            for (int column = from; column <= to; ++column) {
                int inner = touches(tiles.blocks.data + 96 * (size_t)(first + column), side);
                nodes += 16;
                for (; inner; inner &= inner - 1)
                    visit_block(side, first_block + column * length + __builtin_ctz(inner), record);
            }
            return;
        }
        const int all_blocks = (of[1] + 511) / 512;
        for (int sixteen = from / 16; sixteen <= to / 16 && from <= to; ++sixteen) {
            int whole = 0;
            int some = meets(tiles.columns.data + 96 * (size_t)(first / 16 + sixteen), side, whole);
            nodes += 16;
            for (; some; some &= some - 1) {
                const int lane = __builtin_ctz(some), column = 16 * sixteen + lane, block0 = column * length;
                const int blocks = all_blocks - block0 < length ? all_blocks - block0 : length;
                if (whole >> lane & 1) {
                    for (int k = 0; k < 16 * blocks; ++k)
                        accept(16 * (first_block + block0) + k);
                    continue;
                }
                int covered = 0;
                int inner = meets(tiles.blocks.data + 96 * (size_t)(first + column), side, covered);
                nodes += 16;
                for (; inner; inner &= inner - 1) {
                    const int b = __builtin_ctz(inner), block = first_block + block0 + b;
                    if (covered >> b & 1)
                        for (int k = 0; k < 16; ++k)
                            accept(16 * block + k);
                    else
                        visit_block(side, block, record);
                }
            }
        }
    };
    for (int k = first_cluster; k < last_cluster; ++k) {
        const int first = 16 * clusters.data[k], all = gather(first);
        bool taken = false;
        for (int face = 0; face < 6; ++face) {
            const int group = 6 * place + face;
            if (groups[6 * group + 1] == 0)
                continue;
            int some = bound(face);
            if (!some)
                continue;
            if (!taken)
                take(first_record + first, __builtin_popcount(all));
            taken = true;
            for (some &= ~silent; some; some &= some - 1) {
                const int j = __builtin_ctz(some);
                visit(side(face, j), group, first_record + first + j);
            }
        }
    }
    answers.counters.data[nodes_visited] += nodes;
    answers.counters.data[all_entries] += entries;
    report();
"""
)


@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + _BIN + "\n#endif\n")
def bin_light(
    place: int,
    all_entries: int,
    first_record: int,
    first_corner: int,
    first_cluster: int,
    last_cluster: int,
    clusters: wp.array(dtype=int),
    corners: wp.array(dtype=float),
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    list: EntryList,
    answers: Answers,
):
    """The triangles of some clusters, and the light at ``place``; entries that are left stay in the list."""
    ...


@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + TRIANGLE + _TRACE + "flush();\nreport();\n#endif\n")
def trace_list(space: LightSpace, tiles: Tiles, occluders: Occluders, list: EntryList, answers: Answers):
    """Trace what is in the list."""
    ...


@wp.kernel(enable_backward=False)
def bin_wide(
    lights: wp.array(dtype=LightFrame),
    clusters: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    corners: wp.array(dtype=float),
    tiles: Tiles,
    occluders: Occluders,
    list: EntryList,
    answers: Answers,
):
    """One thread. ``clusters``, ``ends`` and ``corners`` are those of ``candidates.py``."""
    blocks = (occluders.count + BLOCK - 1) // BLOCK
    first = int(0)
    slots = 16 * tiles.counts[2]
    for k in range(slots):
        list.total[k] = 0
    list.count[0] = 0
    list.count[1] = 0
    before = answers.counters[0, ENTRIES]
    for place in range(tiles.lights):
        bin_light(
            place,
            ENTRIES,
            place * occluders.count,
            place * blocks * BLOCK,
            first,
            ends[place],
            clusters,
            corners,
            space_of(lights[place]),
            tiles,
            occluders,
            list,
            answers,
        )
        first = ends[place]
    trace_list(space_of(lights[0]), tiles, occluders, list, answers)
    largest = int(0)
    for k in range(slots):
        largest = wp.max(largest, list.total[k])
    wp.atomic_max(answers.counters, 0, LARGEST_TILE, wp.int64(largest))
    wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    entries = answers.counters[0, ENTRIES] - before
    if list.bounded != 0 and entries > wp.int64(list.capacity):
        wp.atomic_add(answers.counters, 0, OVERFLOWS, wp.int64(list.count[1] - 1))
