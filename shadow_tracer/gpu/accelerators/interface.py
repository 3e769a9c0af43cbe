# SPDX-License-Identifier: Apache-2.0
"""The one interface of accelerators, and what they work on."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field

from shadow_tracer.gpu.device.shared import Shared
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.device.workers import Workers
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.rays import project, project_without_rays
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.gpu.visibility.answers import Answers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, AnyHit, Mask, Query


@dataclass(frozen=True)
class Rays:
    """Those of some consecutive lights of the frame, traced together: rays and triangle records lie one after the
    other. Ray number i belongs to light i // count of them and to sample i % count, count being the number of samples.

    Attributes:
        lights: at most ``Traits.lights_at_once`` of them; none if it is the query *mask* that is asked.
        keep: the frame has no other rays, and what is made of them may be asked for ``again``.
        again: rays and states are what they were when they were traced last, with ``keep``, and nothing but the scene
            has changed. Both are only asked of an accelerator that ``keeps_rays``.
        mask: what the query *mask* asks of their samples.
    """

    lights: tuple[LightFrame, ...]
    keep: bool = False
    again: bool = False
    mask: Mask | None = None

    @property
    def light(self) -> LightFrame:
        """The first light; the only one of accelerators that take them one by one."""
        return self.lights[0]

    @property
    def first(self) -> int:
        """Number of the first light."""
        return int(self.lights[0].number)


@dataclass(frozen=True)
class Context:
    """What an accelerator works on. Scene, records, workers and what is shared belong to all of a tracer; frame and
    stages to those that work on the same rays.

    Attributes:
        workers: threads for what one band makes for all (``aim``); inside of ``show`` they are busy.
    """

    samples: SampleSet
    scene: SceneBuffers
    records: TriangleRecords
    stages: Stages
    shared: Shared = field(default_factory=Shared)
    workers: Workers = field(default_factory=lambda: Workers(1))

    def answers(self, rays: Rays) -> Answers:
        """Where the answers of a pass go."""
        samples, scene = self.samples, self.scene
        answers = Answers()
        answers.samples = samples.count
        answers.states = samples.states_of(rays.first, len(rays.lights))
        answers.counters = samples.counters
        answers.queue, answers.queue_count = samples.queue, samples.queue_count_of[rays.first]
        answers.lights, answers.positions = samples.lights_from(rays.first), samples.positions
        answers.vertices, answers.triangles = scene.vertices, scene.triangles
        return answers

    def occluders(self, rays: Rays) -> Occluders:
        """The triangles of the scene as the lights of a pass see them, without corners."""
        occluders = Occluders()
        occluders.count, occluders.triangles = self.scene.triangle_count, self.scene.triangles
        occluders.records = self.records.of(rays.first, len(rays.lights))
        occluders.records_apart = self.records.stride
        return occluders

    def any_hit(self, rays: Rays) -> AnyHit:
        """What the query *any hit* needs for the rays of a light."""
        asked = AnyHit()
        asked.width = self.samples.width
        asked.rays, asked.occluders, asked.answers = self.samples.rays, self.occluders(rays), self.answers(rays)
        return asked

    def key(self, rays: Rays) -> tuple[Hashable, ...]:
        """All that launches of a pass depend on, contents of arrays aside."""
        records = self.records
        numbers = rays.first, len(rays.lights), self.samples.count, self.scene.triangle_count
        return *numbers, records.place(rays.first), records.stride, records.front_face_culling


@dataclass(frozen=True)
class Traits:
    """What an accelerator can do.

    Attributes:
        lights_at_once: the most lights of a pass.
        rays_at_once: rays of a pass of several lights, beyond which one pass after the other is faster; unless they may
            be kept.
        recordable: whether ``show`` may be recorded and replayed: it launches kernels and reads nothing back, and
            nothing it launches depends on more than the numbers of samples and triangles and on what
            ``TriangleRecords.plan`` has said.
        keeps_rays: whether what it makes of the rays of a pass can be used again, see ``Rays.again``.
        queries: what it can be asked (``visibility/queries.py``).
        bundle_costs: of bundles of rays, from a sample to all points of a light, for each node and each triangle, and
            for each triangle and point [ns, on one core of a Xeon of 2023]. As for ``ray_costs`` their ratios matter.
        ray_costs: of hard lights, for each ray, for each triangle of the scene, and for each ray more where samples are
            a list and no image [ns].
    """

    lights_at_once: int = 1
    rays_at_once: int = 1 << 62
    recordable: bool = False
    keeps_rays: bool = False
    queries: tuple[Query, ...] = (ANY_HIT,)
    # Where triangles are judged one by one, each takes 0.07 us in a bundle to 8 points and 0.12 in one to 64; a ray
    # 0.12 to 0.25 us (mesh_bvh: BART robots, conference, the red kitchen, a room of texels).
    bundle_costs: tuple[float, float, float] = (0.0, 50.0, 0.9)
    ray_costs: tuple[float, float, float] = (150.0, 0.0, 0.0)


class Accelerator:
    """Shows rays the triangles that could matter to them; it never decides (``visibility/answers.py``)."""

    traits = Traits()

    def __init__(self, context: Context) -> None:
        self._context = context

    def follow(self) -> None:
        """Make or mend what depends on the occluders alone, for revisions that it was not made for; called before
        any light of a frame, and again when other meshes are left out of the scene, whose revision stays."""

    def forget(self) -> None:
        """What depends on the occluders alone is to be made again, whatever is there."""

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Make what depends on occluders and lights, unless it is there. Called before ``show``, and once for all that
        share the rays of a frame."""
        raise NotImplementedError

    def arrange(self) -> None:
        """What the host makes ready for the number of samples and the width of their image, outside of what is
        recorded."""

    def project(self, rays: Rays, counted: bool = False) -> None:
        """Make the rays of a pass and their states, for ``show``; ``counted``: they are made once more, and have been
        counted."""
        samples = self._context.samples
        with self._context.stages.stage("project"):
            for place, light in enumerate(rays.lights):
                if self.takes_rays(light):
                    project(samples, light.number, place, counted)
                else:
                    project_without_rays(samples, light.number, counted)

    def show(self, rays: Rays, query: Query) -> None:
        """Show rays every triangle that could be in between, in any order, any number of times. ``query``: what is done
        with them, one of ``Traits.queries``."""
        raise NotImplementedError

    def takes_rays(self, light: LightFrame) -> bool:
        """Whether ``show`` looks at the rays of a light for *any hit*, with the scene as it was followed last. Those
        that it does not look at are not made."""
        return True

    def more(self, rays: Rays) -> Iterator[None]:
        """What its list could not hold, as it has told ``SampleSet.parts``: shows all once more, a list at a time, and
        lets waiting pairs be decided in between. The rays are as they were before ``show``."""
        raise NotImplementedError

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Triangles that cast nothing for a light of the frame: degenerate ones, and those culled."""
        return self._context.records.silent(light.number)

    def learn(self, counters: dict[str, int]) -> None:
        """The counters of the frame that just ended; may change how, never what, it shows."""

    def nbytes(self) -> int:
        """Bytes reserved on the device beyond the shared buffers."""
        return 0
