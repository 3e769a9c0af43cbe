# SPDX-License-Identifier: Apache-2.0
"""Launches that are prepared once and then repeated: to pack the arguments takes longer than many a kernel."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import warp as wp

# Sizes that change with every frame would otherwise be kept for ever.
_MOST = 1000


class Launches:
    """Prepared launches on one device, for use by one thread at a time."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._kept: dict[Hashable, tuple[wp.Launch, Sequence[Any]]] = {}

    def __call__(
        self, kernel: Any, key: tuple[Hashable, ...], prepare: Callable[[], tuple[int, Sequence[Any]]]
    ) -> None:
        """Launch ``kernel``.

        Args:
            prepare: returns number of threads and inputs. It is called once for each ``key``, which therefore tells all
                that they depend on but the contents of arrays. A struct among them is read at every launch: it has to
                be made by ``prepare``, or to be right whenever this is called.
        """
        found = self._kept.get((kernel, *key))
        if found is None:
            threads, inputs = prepare()
            if threads == 0:
                return
            if len(self._kept) >= _MOST:
                self._kept.clear()
            launch = wp.launch(kernel, dim=threads, inputs=inputs, device=self._device, record_cmd=True)
            # The launch knows addresses: the inputs have to live as long.
            found = self._kept[(kernel, *key)] = (launch, inputs)
        found[0].launch()
