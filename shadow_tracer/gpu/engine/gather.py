# SPDX-License-Identifier: Apache-2.0
"""What a frame has found, gathered from the shares that worked on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.engine.share import Share
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


def gather_states(working: Sequence[Share], lights: int) -> npt.NDArray[np.uint8]:
    """(L, N) states for ``lights`` lights."""
    states = np.empty((lights, sum(share.frame.count for share in working)), np.uint8)
    for share in working:
        share.copy_states(lights, states)
    return states


def gather_counters(working: Sequence[Share]) -> dict[str, int]:
    """Counters of all together; each pipeline is told those of its own."""
    total: dict[str, int] = {}
    for share in working:
        counters = share.frame.read_counters()
        share.pipeline.learn(counters)
        total = add_up(total, counters)
    return total


def gather_stages(whole: Stages, working: Sequence[Share]) -> dict[str, float]:
    """Milliseconds per stage; ``whole`` are the times of what is done for all at once. Of shares that worked side by
    side, the times of the slowest; and of stages it did not have, what others took: one of them does for all what
    depends on scene and lights alone."""
    own = whole.read()
    if len(working) == 1 and working[0].stages is whole:
        return own
    theirs = [share.stages.read() for share in working]
    theirs.append(max(theirs, key=lambda times: sum(times.values())))
    together: dict[str, float] = {name: own[name] for name in own if name != "download"}
    for times in theirs:
        together |= times
    return together | {"download": own["download"]}
