# SPDX-License-Identifier: Apache-2.0
"""Arrays as the host sees them."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import forms


class Views:
    """Views of arrays of the CPU that live as long as this object, kept: making one takes as long as a launch."""

    def __init__(self) -> None:
        self._made: dict[int, npt.NDArray[Any]] = {}

    def __call__(self, array: wp.array) -> npt.NDArray[Any]:
        """The elements of an array; of a GPU a copy, for which it is waited."""
        view = self._made.get(id(array))
        if view is None:
            if not array.device.is_cpu:
                return array.numpy()
            if len(self._made) > 1000:
                self._made.clear()
            # It holds the array, so that its id stays.
            self._made[id(array)] = view = array.numpy()
        return view


class Clearing:
    """Sets elements of arrays to zero: in the wide form on the host, which takes a tenth of the time.

    Args:
        recorded: whether launches may be recorded, what the host does being no part of a recording.
    """

    def __init__(self, device: Any, recorded: bool) -> None:
        self._views = Views() if forms.wide(device) and not recorded else None

    def __call__(self, *arrays: wp.array) -> None:
        """Set arrays to zero."""
        for array in arrays:
            if self._views is None:
                array.zero_()
            else:
                self._views(array).fill(0)
