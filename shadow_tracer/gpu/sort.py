# SPDX-License-Identifier: Apache-2.0
"""Sorting by integer key, with buffers allocated once."""

from __future__ import annotations

from typing import Any

import warp as wp


class KeySort:
    """Keys and values of up to ``capacity`` elements, sorted by key in place; equal keys keep their order.

    ``keys`` and ``values`` are int32 of twice the capacity: the second half is the radix sort's scratch memory.
    """

    def __init__(self, capacity: int, device: Any) -> None:
        self.keys = wp.empty(2 * capacity, dtype=wp.int32, device=device)
        self.values = wp.empty(2 * capacity, dtype=wp.int32, device=device)

    def sort(self, count: int, bits: int) -> None:
        """Sort the first ``count`` pairs by the lowest ``bits`` bits of their keys (all other bits being zero)."""
        if count > 1:
            wp.utils.radix_sort_pairs(self.keys, self.values, count, 0, bits)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.keys.capacity + self.values.capacity)
