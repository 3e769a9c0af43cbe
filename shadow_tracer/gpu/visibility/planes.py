# SPDX-License-Identifier: Apache-2.0
"""States packed on the device, two bits a sample, so that a quarter of the bytes goes down to the host."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.gpu.visibility.packed_states import PackedStates, words_of


# A thread makes a word of both planes: it reads 32 bytes, which is a sector of the cache.
@wp.kernel(enable_backward=False)
def pack_states(count: int, words: int, states: wp.array(dtype=wp.uint8), planes: wp.array(dtype=wp.uint32)):
    """``planes`` of the ``states`` of lights with ``count`` samples each, ``words`` for a plane."""
    light = wp.tid() // words
    word = wp.tid() - light * words
    begin = light * count + 32 * word
    low = wp.uint32(0)
    high = wp.uint32(0)
    for k in range(wp.min(32, count - 32 * word)):
        state = wp.uint32(states[begin + k])
        low |= (state & wp.uint32(1)) << wp.uint32(k)
        high |= ((state >> wp.uint32(1)) & wp.uint32(1)) << wp.uint32(k)
    planes[2 * light * words + word] = low
    planes[(2 * light + 1) * words + word] = high


class StatePlanes:
    """Room for the planes of a frame, on the device and the host."""

    def __init__(self, samples: SampleSet) -> None:
        self._samples = samples
        room = samples.bounds.max_lights * 2 * words_of(samples.bounds.max_rays)
        self._planes = samples.host.add(wp.empty(room, dtype=wp.uint32, device=samples.device), whole=False)

    def pack(self, lights: int) -> None:
        """Make the planes of ``lights`` lights; may be recorded."""
        samples, words = self._samples, words_of(self._samples.count)

        def prepare() -> tuple[int, list[Any]]:
            return lights * words, [samples.count, words, samples.states, self._planes]

        samples.launch(pack_states, (lights, samples.count), prepare)

    def fetch(self, lights: int) -> None:
        """Copy them to the host, and with them all else that it wants to know of the frame; wait for the device."""
        self._samples.host.fetch(self._planes, self._size(lights))

    def read(self, lights: int) -> PackedStates:
        """The states that were fetched, in memory of their own."""
        samples = self._samples
        words = words_of(samples.count)
        planes = samples.host.read(self._planes)[: 2 * lights * words].astype(np.uint32, copy=True)
        return PackedStates(planes.reshape(lights, 2, words), samples.count)

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        return int(self._planes.capacity)

    def _size(self, lights: int) -> int:
        return max(1, 2 * lights * words_of(self._samples.count))
