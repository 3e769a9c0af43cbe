# SPDX-License-Identifier: Apache-2.0
"""Rays of the frame before, taken again when neither samples nor lights have changed: a camera and a world that rest
while meshes move, or points that are asked about again and again."""

from __future__ import annotations

import numpy as np

from shadow_tracer.gpu.device.counters import RAYS
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.samples.sample_set import SampleSet


class KeptRays:
    """Remembers of the pass that was projected last what tracing changes: states, and the number of rays. The rays lie
    where they lay; whoever overwrites them gives the buffers another ``SampleSet.revision``. For the CPU."""

    def __init__(self, samples: SampleSet) -> None:
        self._samples = samples
        self._states = np.empty(samples.bounds.max_rays * samples.bounds.max_lights, np.uint8)
        self._rays = 0
        self._revision = -1
        self._lights: tuple[LightFrame, ...] = ()
        self._structured = False

    def forget(self) -> None:
        """They will have to be made again."""
        self._revision, self._lights, self._structured = -1, (), False

    def rays_so_far(self) -> int:
        """Rays of the passes of this frame that have been made."""
        return int(np.add.reduce(self._samples.views(self._samples.counters)[:, RAYS]))

    def keep(self, lights: tuple[LightFrame, ...], before: int) -> None:
        """The rays of a pass have just been made, and nothing of them yet; ``before``: rays of earlier passes."""
        samples = self._samples
        states = samples.views(samples.states_of(lights[0].number, len(lights)))
        self._states[: states.size] = states
        self._rays = self.rays_so_far() - before
        self._revision, self._lights, self._structured = samples.revision, lights, False

    def structured(self) -> None:
        """The pipeline has made of the rays what it can use again."""
        self._structured = True

    def recall(self, lights: tuple[LightFrame, ...]) -> bool:
        """Whether the rays of the pass are there, and what the pipeline has made of them; then their states are again
        what they were before tracing."""
        samples = self._samples
        same = len(lights) == len(self._lights) and all(map(_is, lights, self._lights))
        if not (same and self._structured and self._revision == samples.revision):
            return False
        states = samples.views(samples.states_of(lights[0].number, len(lights)))
        states[:] = self._states[: states.size]
        samples.views(samples.counters)[0, RAYS] += self._rays
        return True

    def nbytes(self) -> int:
        """Bytes on the host."""
        return self._states.nbytes


def _is(one: LightFrame, other: LightFrame) -> bool:
    return one is other
