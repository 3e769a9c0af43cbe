# SPDX-License-Identifier: Apache-2.0
"""Parts of device arrays."""

from __future__ import annotations

import warp as wp


class Slices:
    """Parts of arrays, kept: making one takes as long as a launch."""

    def __init__(self) -> None:
        self._made: dict[tuple[int, int, int], wp.array] = {}

    def __call__(self, array: wp.array, first: int, count: int) -> wp.array:
        """Elements ``first`` to ``first + count`` of an array that lives as long as this object."""
        key = (int(array.ptr or 0), first, count)
        made = self._made.get(key)
        if made is None:
            if len(self._made) > 1000:
                self._made.clear()
            # Not read back: another thread may clear meanwhile.
            self._made[key] = made = array[first : first + count]
        return made
