# SPDX-License-Identifier: Apache-2.0
"""Entries to lists by tile, and the tiles traced in chunks of their lists: the second half of what ``binning.py``
begins."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.binning import (
    NEXT_TO_EMIT,
    NEXT_TO_TRACE,
    Bins,
    first_lane,
    last_lane,
    take,
    works,
)
from shadow_tracer.gpu.accelerators.light_grid.tiles import ALL_BLOCKS, Tiles
from shadow_tracer.gpu.device.counters import ACCEPTED, ENTRIES, LARGEST_TILE, LEAF_TESTS, PASSES, SPLITS
from shadow_tracer.gpu.exact.decision import NO, filter_pair
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LIT, SHADOWED
from shadow_tracer.gpu.visibility.answers import Answers, settle

CHUNK = wp.constant(64)  # entries that a warp takes at a time


@wp.kernel(enable_backward=False)
def write_covered(tiles: Tiles, answers: Answers):
    """The rays of tiles that a triangle covers. One thread per tile."""
    tile = wp.tid()
    if (tile >> 4) >= tiles.counts[ALL_BLOCKS] or tiles.covered[tile] == 0:
        return
    live = tiles.live[tile]
    tiles.live[tile] = 0
    wp.atomic_add(answers.counters, tile & 63, ACCEPTED, wp.int64(1))
    for j in range(32):
        if ((live >> j) & 1) != 0:
            answers.states[tiles.order[32 * tile + j]] = wp.uint8(SHADOWED)


@wp.kernel(enable_backward=False)
def start_part(units: int, part: int, bins: Bins, parts: wp.array(dtype=int), answers: Answers):
    """Number of parts, and of the entries of this one; nothing is taken yet. One thread."""
    bins.item_count[NEXT_TO_EMIT] = 0
    bins.item_count[NEXT_TO_TRACE] = 0
    total = bins.offsets[units - 1]
    capacity = wp.int64(bins.capacity)
    bins.emitted[0] = int(wp.min(wp.max(total - wp.int64(part) * capacity, wp.int64(0)), capacity))
    parts[0] = int(wp.min((total + capacity - wp.int64(1)) / capacity, wp.int64(2147483647)))
    # The last part says it for all: a frame that needs parts begins again.
    if wp.int64(part) == wp.max(total - wp.int64(1), wp.int64(0)) / capacity:
        wp.atomic_add(answers.counters, 0, ENTRIES, total)
    if part == 0:
        wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))


@wp.kernel(enable_backward=False)
def scatter_entries(stride: int, bins: Bins):
    """Bring the entries of each tile together."""
    i = wp.tid()
    while i < bins.emitted[0]:
        bins.sorted[bins.start[bins.tile[i]] + bins.rank[i]] = bins.record[i]
        i += stride


@wp.kernel(enable_backward=False)
def count_chunks(part: int, tile_places: int, bins: Bins, answers: Answers):
    """One thread per tile, and one more."""
    tile = wp.tid()
    length = int(0)
    if tile < tile_places:
        length = bins.length[tile]
        if part > 0:
            bins.total[tile] += length
        else:
            bins.total[tile] = length
        if bins.total[tile] > int(answers.counters[tile & 63, LARGEST_TILE]):
            wp.atomic_max(answers.counters, tile & 63, LARGEST_TILE, wp.int64(bins.total[tile]))
    chunks = (length + CHUNK - 1) // CHUNK
    bins.chunks[tile] = chunks
    if chunks > 1:
        wp.atomic_add(answers.counters, tile & 63, SPLITS, wp.int64(chunks - 1))


@wp.kernel(enable_backward=False)
def list_chunks(bins: Bins):
    """One thread per tile."""
    tile = wp.tid()
    first = bins.chunks[tile]
    for k in range(bins.chunks[tile + 1] - first):
        bins.work[first + k] = wp.vec2i(tile, k)


@wp.kernel(enable_backward=False)
def trace_chunks(tile_places: int, tiles: Tiles, occluders: Occluders, bins: Bins, answers: Answers):
    """Warps take one chunk after the other, each of the 32 lanes a ray."""
    thread = wp.tid()
    if not works(thread):
        return
    tests = int(0)
    w = take(bins.item_count, NEXT_TO_TRACE)
    while w < bins.chunks[tile_places]:
        tile = bins.work[w][0]
        begin = bins.start[tile] + bins.work[w][1] * CHUNK
        end = wp.min(begin + CHUNK, bins.start[tile] + bins.length[tile])
        for lane in range(first_lane(), last_lane()):
            sample = tiles.order[32 * tile + lane]
            live = ((tiles.live[tile] >> lane) & 1) != 0
            if live:
                live = answers.states[sample] == wp.uint8(LIT)
            if live:
                base = (2 * tile + (lane >> 4)) * 80 + (lane & 15)
                ray = wp.vec4(tiles.rays[base], tiles.rays[base + 16], tiles.rays[base + 32], tiles.rays[base + 48])
                magnitude = tiles.rays[base + 64]
                k = begin
                while k < end:
                    record = bins.sorted[k]
                    answer = filter_pair(ray, magnitude, occluders.records, record)
                    tests += 1
                    k += 1
                    if answer != NO and settle(sample, record % occluders.records_apart, answer, answers):
                        k = end
        w = take(bins.item_count, NEXT_TO_TRACE)
    if tests > 0:
        wp.atomic_add(answers.counters, thread & 63, LEAF_TESTS, wp.int64(tests))
