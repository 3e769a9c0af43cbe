# SPDX-License-Identifier: Apache-2.0
"""Variant ``linear``: boxes of cubified direction with a range of depth, start cells from a lookup table."""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.cone_hierarchy import descent
from shadow_tracer.gpu.accelerators.cone_hierarchy.boxes import RayTreeBuffers
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays, Traits
from shadow_tracer.gpu.accelerators.ray_keys import RayOrder
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.corners import Corners
from shadow_tracer.gpu.visibility.queries import Query

# Threads that share the large triangles.
_BIG_THREADS_CUDA = 131072


class LinearHierarchy(Accelerator):
    """The pipeline's variant ``linear``; see ``boxes.py`` and ``descent.py``."""

    def __init__(self, variant: str, context: Context) -> None:
        self._context = context
        self._admission = Admission(context)
        self._corners = context.shared.take(Corners, lambda: Corners(context.records))
        self._wide = forms.wide(context.samples.device)
        self._order = RayOrder(context, self._admission, hilbert=False, packed=self._wide)
        self.traits = Traits(recordable=not self._wide)
        self._buffers = RayTreeBuffers(context, self._order, self._admission, self._wide)
        capacity = 1 if self._wide else context.samples.bounds.max_triangles
        self._big = wp.empty(capacity, dtype=int, device=context.samples.device)
        self._big_count = wp.zeros(1, dtype=int, device=context.samples.device)

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records and corners of the light."""
        with self._context.stages.stage("setup"):
            self._corners.make(lights[0], self._context.records.prepare(lights[0]))

    def show(self, rays: Rays, query: Query) -> None:
        """Build the tree of the light's rays and send all triangles through it."""
        light, stages = rays.first, self._context.stages
        with stages.stage("sort"):
            self._admission.admit(rays)
            self._order.sort(light)
        with stages.stage("build"):
            self._buffers.build(light)
        with stages.stage("trace"):
            self._descend(rays)
            self._admission.test_wild(rays)

    def _descend(self, rays: Rays) -> None:
        light = rays.first
        buffers, scene, tree = self._context.samples, self._context.scene, self._buffers.tree
        device = buffers.device
        occluders = self._context.occluders(rays)
        occluders.corners = self._corners.of(light)
        inputs = [buffers.light_frame_of[light], tree, occluders, self._context.answers(rays)]
        if self._wide:
            wp.launch(descent.descend_wide, dim=1, inputs=inputs, device=device)
            return
        self._big_count.zero_()
        inputs += [self._big, self._big_count]
        wp.launch(descent.descend_triangles, dim=scene.triangle_count, inputs=inputs, device=device)
        threads = forms.tasks(device, _BIG_THREADS_CUDA)
        wp.launch(descent.descend_big, dim=threads, inputs=[threads, *inputs], device=device)
        wp.launch(descent.write_accepted, dim=buffers.count, inputs=[tree, buffers.states_of(light)], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        parts = (self._admission, self._order, self._buffers)
        return sum(part.nbytes() for part in parts) + int(self._big.capacity + self._big_count.capacity)
