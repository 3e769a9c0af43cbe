# SPDX-License-Identifier: Apache-2.0
"""Sorting by integer key, with buffers allocated once."""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms


# Warp's own radix sort takes digits of 16 bits on the CPU, whose 65,536 counters and write positions do not fit the
# first cache; up to 12 bits do. A digit that all keys share is skipped.
@wp.func_native(
    r"""
    int next[4096];
    int at = 0;
    // As few digits as there can be, of about the same size.
    const int passes = (last_bit - first_bit + 11) / 12, digit = (last_bit - first_bit + passes - 1) / passes;
    for (int shift = first_bit; shift < last_bit; shift += digit) {
        const int mask = (1 << (last_bit - shift < digit ? last_bit - shift : digit)) - 1;
        const int* key = keys.data + (size_t)at * count;
        const int* value = values.data + (size_t)at * count;
        int* to_key = keys.data + (size_t)(1 - at) * count;
        int* to_value = values.data + (size_t)(1 - at) * count;
        for (int j = 0; j <= mask; ++j)
            next[j] = 0;
        for (int i = 0; i < count; ++i)
            ++next[key[i] >> shift & mask];
        if (count == 0 || next[key[0] >> shift & mask] == count)
            continue;
        int sum = 0;
        for (int j = 0; j <= mask; ++j) {
            const int here = next[j];
            next[j] = sum;
            sum += here;
        }
        for (int i = 0; i < count; ++i) {
            const int to = next[key[i] >> shift & mask]++;
            to_key[to] = key[i];
            to_value[to] = value[i];
        }
        at = 1 - at;
    }
    for (int i = 0; at == 1 && i < count; ++i) {
        keys.data[i] = keys.data[count + i];
        values.data[i] = values.data[count + i];
    }
    """
)
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
