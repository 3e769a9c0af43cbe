# SPDX-License-Identifier: Apache-2.0
"""Two accelerators over one scene: what one of them leaves aside goes through another one.

That is right because answers only ever go one way, from lit to in shadow (``visibility/answers.py``): each shows the
rays the triangles of its part that could matter, in whichever order, and together these are all.

The part that is left aside is copied once more, into buffers with their own numbers and records: so the other
accelerator never sees the rest of the scene, and no record is made of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.registry import make_pipeline
from shadow_tracer.gpu.accelerators.walker import Walker
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.shared import Shared
from shadow_tracer.gpu.device.transfers import HostCopies
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, Query
from shadow_tracer.gpu.visibility.queue import Pending, WaitingPairs
from shadow_tracer.scene.mesh import Mesh
from shadow_tracer.scene.some import Some


class _Copy:
    """Some of the meshes on the device, and what is known of their triangles from a light: for all who share rays."""

    def __init__(self, context: Context) -> None:
        samples = context.samples
        self.scene = SceneBuffers(context.records.bounds, samples.device)
        host = HostCopies(samples.device, mirrored=False)
        lights = [context.records.light_frame(number) for number in range(context.records.bounds.max_lights)]
        self.records = TriangleRecords(context.records.bounds, self.scene, lights, host)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self.scene.nbytes() + self.records.nbytes()


class Rest:
    """The meshes that an accelerator leaves aside, and the accelerator that they go through.

    Args:
        context: that of the accelerator.
        names: pipeline and variant of the other one, a walker.
    """

    def __init__(self, context: Context, names: tuple[str, str]) -> None:
        self._whole = context
        self._copy: _Copy = context.shared.take(_Copy, lambda: _Copy(context))
        self._context = replace(context, scene=self._copy.scene, records=self._copy.records, shared=Shared())
        pipeline = make_pipeline(*names, self._context)
        assert isinstance(pipeline, Walker)
        self.pipeline, self._loaded = pipeline, False
        bounds, device = context.samples.bounds, context.samples.device
        self._waiting = None if forms.wide(device) else WaitingPairs(bounds.max_rays, bounds.queue_capacity, device)

    @property
    def triangle_count(self) -> int:
        """Numbers of triangles, gaps among them; 0 if there is no mesh."""
        return self._copy.scene.triangle_count

    def follow(self, meshes: Sequence[Mesh]) -> None:
        """Take these meshes, as they are now."""
        scene = self._copy.scene
        scene.leave_out(())
        scene.sync(Some(meshes, self._whole.scene.copied))
        self.pipeline.follow()
        if scene.triangle_count and not self._loaded:
            self.pipeline.build.walk.load(ANY_HIT, scene.device)
            self._loaded = True

    def forget(self) -> None:
        """What depends on the meshes is to be made again."""
        self._copy.records.forget()
        self.pipeline.forget()

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Make what depends on a light."""
        records = self._copy.records
        self._copy.scene.leave_out(self._whole.scene.names_left_out)
        records.front_face_culling = self._whole.records.front_face_culling
        records.plan(lights, 1)
        if self._copy.scene.triangle_count:
            self.pipeline.aim(lights)

    def show(self, rays: Rays, query: Query) -> None:
        """Show them to the rays of a pass, and decide what has to wait: the pairs of a pass name triangles by the
        numbers that they have here."""
        if not self._copy.scene.triangle_count:
            return
        self.pipeline.show(rays, query)
        if self._waiting is not None:
            context = self._context

            def pending() -> Pending:
                counts = context.samples.count, context.records.stride, context.scene.triangle_count
                return Pending(context.answers(rays), *counts, context.samples.rays, context.records.of(rays.first))

            self._waiting.decide(context.key(rays), pending)
            context.samples.queue_count_of[rays.first].zero_()

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Those of them that cast nothing for the light that was aimed at last."""
        return self._copy.records.silent(light.number)

    def nbytes(self) -> int:
        """Bytes on the device beside the copy, which is shared."""
        return self.pipeline.nbytes() + (self._waiting.nbytes() if self._waiting is not None else 0)
