# SPDX-License-Identifier: Apache-2.0
"""Sorting by integer key, with buffers allocated once."""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms, native

native.constants(SORT_DIGIT=12)  # bits


@native.func_native("device/sort.h", calls="Sort::pairs")
def sort_pairs(count: int, first_bit: int, last_bit: int, keys: wp.array(dtype=int), values: wp.array(dtype=int)):
    """Stable sort of ``count`` pairs by some bits of non-negative keys, with the arrays' next ``count`` elements as
    scratch."""
    ...


@wp.kernel(enable_backward=False)
def sort_pairs_cpu(count: int, first_bit: int, last_bit: int, keys: wp.array(dtype=int), values: wp.array(dtype=int)):
    """One thread."""
    sort_pairs(count, first_bit, last_bit, keys, values)


class KeySort:
    """Keys and values of up to ``capacity`` elements, sorted by key in place; equal keys keep their order.

    ``keys`` (not negative) and ``values`` are int32 of twice the capacity: the second half is scratch memory.
    """

    def __init__(self, capacity: int, device: Any) -> None:
        self.keys = wp.empty(2 * capacity, dtype=wp.int32, device=device)
        self.values = wp.empty(2 * capacity, dtype=wp.int32, device=device)

    def sort(self, count: int, first_bit: int, last_bit: int) -> None:
        """Sort the first ``count`` pairs by the bits of their keys from ``first_bit`` up to, but without,
        ``last_bit``."""
        if forms.wide(self.keys.device):
            # However few: then the kernel is loaded in the first frame, whatever is in it.
            inputs = [count, first_bit, last_bit, self.keys, self.values]
            wp.launch(sort_pairs_cpu, dim=1, inputs=inputs, device=self.keys.device)
        elif count > 1:
            wp.utils.radix_sort_pairs(self.keys, self.values, count, first_bit, last_bit)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.keys.capacity + self.values.capacity)
