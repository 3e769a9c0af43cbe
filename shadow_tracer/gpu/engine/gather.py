# SPDX-License-Identifier: Apache-2.0
"""What a frame has found, gathered from the bands that worked on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.engine.band import Band
from shadow_tracer.gpu.visibility.light_bits import Reaching
from shadow_tracer.gpu.visibility.light_points import add_up
from shadow_tracer.gpu.visibility.packed_states import PackedStates, as_bytes


@dataclass(frozen=True)
class Traced:
    """Result of a frame: (L, N) states, milliseconds per stage, counters; for each light with size, by its number,
    which of its points reach."""

    found: PackedStates | npt.NDArray[np.uint8]
    stages: dict[str, float]
    counters: dict[str, int]
    reaching: dict[int, Reaching] = field(default_factory=dict)

    @property
    def states(self) -> npt.NDArray[np.uint8]:
        """A byte each."""
        return as_bytes(self.found)


def gather_states(working: Sequence[Band], lights: int) -> npt.NDArray[np.uint8]:
    """(L, N) states for ``lights`` lights."""
    states = np.empty((lights, sum(band.samples.count for band in working)), np.uint8)
    for band in working:
        band.copy_states(lights, states)
    return states


def gather_counters(working: Sequence[Band]) -> dict[str, int]:
    """Counters of all together; each pipeline learns from those of its own rays."""
    total: dict[str, int] = {}
    for band in working:
        counters = band.samples.read_counters()
        band.pipeline.learn(counters)
        total = add_up(total, counters) if total else counters
    return total


def gather_stages(whole: Stages, working: Sequence[Band]) -> dict[str, float]:
    """Milliseconds per stage; ``whole`` are the times of what is done for all at once. Of bands that worked side by
    side, the times of the slowest; and of stages it did not have, what others took: one of them does for all what
    depends on scene and lights alone."""
    own = whole.read()
    if len(working) == 1 and working[0].stages is whole:
        return own
    theirs = [band.stages.read() for band in working]
    theirs.append(max(theirs, key=lambda times: sum(times.values())))
    together: dict[str, float] = {name: own[name] for name in own if name != "download"}
    for times in theirs:
        together |= times
    return together | {"download": own["download"]}
