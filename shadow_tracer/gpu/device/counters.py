# SPDX-License-Identifier: Apache-2.0
"""The columns of the counters that kernels add to."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native

# Columns of the counter array. Each has 64 rows that threads spread over, so that they do not queue for one address.
COUNTERS = ("rays", "nodes_visited", "leaf_tests", "retested", "exact", "accepted", "passes", "peak_queue")
COUNTERS += ("entries", "largest_tile", "splits", "overflows")
RAYS = wp.constant(0)
NODES_VISITED = wp.constant(1)
LEAF_TESTS = wp.constant(2)
RETESTED = wp.constant(3)
EXACT = wp.constant(4)
ACCEPTED = wp.constant(5)
PASSES = wp.constant(6)
PEAK_QUEUE = wp.constant(7)
ENTRIES = wp.constant(8)
LARGEST_TILE = wp.constant(9)
SPLITS = wp.constant(10)
OVERFLOWS = wp.constant(11)  # further passes within a pipeline
native.constants(RAYS=RAYS, NODES_VISITED=NODES_VISITED, LEAF_TESTS=LEAF_TESTS, RETESTED=RETESTED, EXACT=EXACT)
native.constants(ACCEPTED=ACCEPTED, PASSES=PASSES, ENTRIES=ENTRIES)
LARGEST = ("peak_queue", "largest_tile")  # of these the largest value of any row counts, not the sum
ROWS = 64
native.constants(COUNTER_ROWS=ROWS)


@wp.func_native(
    native.snippet("device/warp.h", call="Warp::add(counters.data + counters.shape[1] * row + column, number);")
)
def add_to(counters: wp.array2d(dtype=wp.int64), row: int, column: int, number: int):
    """Add to a counter: to one of its rows, ``row`` or that of a neighbouring thread."""
    ...
