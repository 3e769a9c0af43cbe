# SPDX-License-Identifier: Apache-2.0
"""The one interface of accelerators, and what they work on."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar
from weakref import WeakValueDictionary

from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.samples.sample_set import FrameBuffers
from shadow_tracer.gpu.visibility.answers import Answers
from shadow_tracer.gpu.visibility.queries import Mask

_Kind = TypeVar("_Kind")


class Shared:
    """What accelerators make of a light beside its records, once for all that work on the scene: one of a kind, which
    lives as long as an accelerator holds it."""

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
    """What an accelerator works on. Scene, records and what is shared belong to all of a tracer; frame and stages to
    those that work on the same rays."""

    frame: FrameBuffers
    scene: SceneBuffers
    records: TriangleRecords
    stages: Stages
    shared: Shared = field(default_factory=Shared)

    def answers(self, work: Pass) -> Answers:
        """Where the answers of a pass go."""
        frame, scene = self.frame, self.scene
        answers = Answers()
        answers.samples = frame.count
        answers.states = frame.states_of(work.first, len(work.lights))
        answers.counters = frame.counters
        answers.queue, answers.queue_count = frame.queue, frame.queue_count_of[work.first]
        answers.lights, answers.positions = frame.lights_from(work.first), frame.samples
        answers.vertices, answers.triangles = scene.vertices, scene.triangles
        return answers

    def occluders(self, work: Pass) -> Occluders:
        """The triangles of the scene as the lights of a pass see them, without corners."""
        occluders = Occluders()
        occluders.count, occluders.triangles = self.scene.triangle_count, self.scene.triangles
        occluders.records = self.records.of(work.first, len(work.lights))
        occluders.records_apart = self.records.stride
        return occluders

    def key(self, work: Pass) -> tuple[Hashable, ...]:
        """All that launches of a pass depend on, contents of arrays aside."""
        records = self.records
        numbers = work.first, len(work.lights), self.frame.count, self.scene.triangle_count
        return *numbers, records.place(work.first), records.stride, records.front_face_culling


@dataclass(frozen=True)
class Traits:
    """What an accelerator can do.

    Attributes:
        lights_at_once: the most lights of a pass.
        recordable: whether ``show`` may be recorded and replayed: it launches kernels and reads nothing back, and
            nothing it launches depends on more than the numbers of samples and triangles and on what
            ``TriangleRecords.plan`` has said.
        keeps_rays: whether what it makes of the rays of a pass can be used again, see ``Pass.again``.
        masks: whether it answers the query *mask* (``show_points``).
    """

    lights_at_once: int = 1
    recordable: bool = False
    keeps_rays: bool = False
    masks: bool = False


class Accelerator:
    """Shows rays the triangles that could matter to them; it never decides (``visibility/answers.py``)."""

    traits = Traits()

    def follow(self) -> None:
        """Make or mend what depends on the occluders alone, for revisions that it was not made for; called before
        any light of a frame, and again when other meshes are left out of the scene, whose revision stays."""

    def aim(self, work: Pass) -> None:
        """Make what depends on occluders and lights, unless it is there. Called before ``show``, and once for all that
        share the rays of a frame."""
        raise NotImplementedError

    def show(self, work: Pass) -> None:
        """Show the rays of a pass every triangle that could be in between, in any order, any number of times."""
        raise NotImplementedError

    def more(self, work: Pass) -> Iterator[None]:
        """What its list could not hold, as it has told ``FrameBuffers.parts``: shows all once more, a list at
        a time, and lets waiting pairs be decided in between. The rays are as they were before ``show``."""
        raise NotImplementedError

    def show_points(self, asked: Mask) -> None:
        """Show samples every triangle that could be between them and any of some points of a light."""
        raise NotImplementedError

    def learn(self, counters: dict[str, int]) -> None:
        """The counters of the frame that just ended; may change how, never what, it shows."""

    def nbytes(self) -> int:
        """Bytes reserved on the device beyond the shared buffers."""
        return 0
