# SPDX-License-Identifier: Apache-2.0
"""What a pipeline works on, and what it is asked to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar
from weakref import WeakValueDictionary

from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.samples.sample_set import FrameBuffers

_Kind = TypeVar("_Kind")


class Shared:
    """What pipelines make of a light beside its records, once for all that work on the scene: one of a kind, which
    lives as long as a pipeline holds it."""

    def __init__(self) -> None:
        self._made: WeakValueDictionary[type[Any], Any] = WeakValueDictionary()

    def take(self, kind: type[_Kind], make: Callable[[], _Kind]) -> _Kind:
        """The one of its kind, made when nobody has it."""
        made = self._made.get(kind)
        if made is None:
            self._made[kind] = made = make()
        found: _Kind = made
        return found

    def find(self, kind: type[_Kind]) -> _Kind | None:
        """The one of its kind, None if nobody has it."""
        return self._made.get(kind)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(made.nbytes() for made in self._made.values())


@dataclass(frozen=True)
class Context:
    """What a pipeline works on. Scene, records and what is shared belong to all pipelines of a tracer; frame and stages
    to those that work on the same rays."""

    frame: FrameBuffers
    scene: SceneBuffers
    records: TriangleRecords
    stages: Stages
    shared: Shared = field(default_factory=Shared)


class Pipeline(Protocol):
    """One way to find shadows. A pipeline shows triangles to the shadow test; it never decides by itself."""

    @property
    def recordable(self) -> bool:
        """Whether ``trace`` with attempt 0 may be recorded and replayed: it launches kernels and reads nothing back,
        and nothing it launches depends on more than the numbers of samples and triangles and on what
        ``TriangleRecords.plan`` has said."""

    def follow(self) -> None:
        """Make or mend what depends on the scene alone, if its revision is not the one that this was made for; called
        once per frame before any light."""

    @property
    def lights_together(self) -> int:
        """The most lights of a pass."""

    @property
    def keeps_rays(self) -> bool:
        """Whether what it makes of the rays of a pass can be used again, see ``Pass.again``."""

    def prepare(self, work: Pass) -> None:
        """Make what depends on scene and lights alone, unless it is there. Called before ``trace``, and once for all
        pipelines that share the rays of a frame."""

    def trace(self, work: Pass) -> None:
        """Look for an occluder of every ray of the pass."""

    def learn(self, counters: dict[str, int]) -> None:
        """Told the counters of the frame that just ended; a pipeline may adapt how, never what, it answers."""

    def nbytes(self) -> int:
        """Bytes reserved on the device beyond the shared buffers."""
