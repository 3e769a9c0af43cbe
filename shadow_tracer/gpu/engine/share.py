# SPDX-License-Identifier: Apache-2.0
"""Rays of a frame, all or a share of them, and a pipeline of their own: from depth to states.

Several shares work side by side (``workers.py``). What they have in common, the scene and what is made of it for a
light, is made before and only read; everything they write is their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.accelerators.interface import Context, Pipeline
from shadow_tracer.gpu.accelerators.registry import make_pipeline
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.samples import normals, pixels, rays
from shadow_tracer.gpu.samples.held import Source, depth_of
from shadow_tracer.gpu.samples.kept_rays import KeptRays
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.samples.sample_set import FrameBuffers
from shadow_tracer.gpu.visibility import queue

# Threads that share the queue: enough to fill a GPU, and one on the CPU where threads run one after the other.
_RESOLVERS_CUDA = 65536


class Share:
    """Rays and who finds their occluders.

    Args:
        keep: whether rays may be taken again while neither samples nor lights change.

    Attributes:
        frame: their buffers.
        names: pipeline and variant.
        pipeline: it.
        followed: the revision of the scene that the pipeline has followed last, None if there is none yet.
        busy: seconds that a frame's rays have taken, set to zero by whoever begins one.
    """

    def __init__(self, context: Context, pipeline: str, variant: str, keep: bool = False) -> None:
        self.context = context
        self.frame: FrameBuffers = context.frame
        self.names = (pipeline, variant)
        self.pipeline: Pipeline = make_pipeline(pipeline, variant, context)
        self.followed: Revision | None = None
        self.busy = 0.0
        self._kept = KeptRays(self.frame) if keep and self.pipeline.keeps_rays else None
        self._again = False

    @property
    def stages(self) -> Stages:
        """Times of the stages."""
        return self.context.stages

    def follow(self) -> None:
        """Let the pipeline make what it makes of the scene alone."""
        self.pipeline.follow()
        self.followed = self.context.scene.revision

    def begin(self, source: Source | None) -> None:
        """Counters to zero; samples of a depth image if there are to be new ones."""
        frame = self.frame
        frame.counters.zero_()
        frame.queue_counts.zero_()
        frame.parts.zero_()
        if source is not None:
            depth = depth_of(frame, source.format)
            with self.stages.stage("unproject"):
                pixels.unproject_image(frame.mine(depth), frame)
                if source.normals:
                    normals.displace(depth, frame)

    def prepare(self, work: Pass) -> None:
        """Make what depends on scene and lights alone. It belongs to all shares: one of them does it."""
        if self.context.scene.triangle_count:
            self.pipeline.prepare(work)

    def project(self, work: Pass, again: int = rays.FIRST_TIME) -> None:
        """Rays of the samples, unless they are there from the frame before."""
        self._again = self._kept is not None and again == rays.FIRST_TIME and self._kept.recall(work)
        if self._again:
            return
        if self._kept is None:
            self.frame.renew()  # the rays of another share in the same buffers are overwritten
        before = self._kept.rays_so_far() if self._kept is not None else 0
        with self.stages.stage("project"):
            for place, light in enumerate(work.lights):
                rays.project(self.frame, light.number, place, again)
        if self._kept is None:
            return
        if again == rays.FIRST_TIME:
            self._kept.keep(work, before)
        else:
            self._kept.forget()

    def trace(self, work: Pass) -> None:
        """Find their occluders, and decide the pairs on the queue."""
        frame, scene = self.frame, self.context.scene
        if scene.triangle_count == 0:
            return
        self.pipeline.trace(replace(work, keep=True, again=self._again) if self._kept is not None else work)
        if self._kept is not None and work.attempt == work.part == 0:
            self._kept.structured()
        threads = forms.tasks(frame.device, min(_RESOLVERS_CUDA, frame.bounds.queue_capacity))

        def prepare() -> tuple[int, list[Any]]:
            inputs = [frame.lights_from(work.first), frame.count, threads, frame.queue]
            inputs += [frame.queue_count_of[work.first], frame.samples, scene.vertices, scene.triangles]
            return threads, [*inputs, frame.states_of(work.first, len(work.lights)), frame.counters]

        with self.stages.stage("resolve"):
            frame.launch(queue.resolve_queue, (work.first, len(work.lights), frame.count), prepare)

    def finish_overflow(self, passes: Sequence[Pass]) -> int:
        """Further passes for lights whose queue overflowed, or whose pipeline had more work than its lists hold, as the
        host has fetched. Only here it waits for the device before the result."""
        further = 0
        host = self.frame.host
        queued, parts = host.read(self.frame.queue_counts).copy(), host.read(self.frame.parts).copy()
        for work in passes:
            in_parts = parts[work.first] > 1
            if not in_parts and queued[work.first] <= self.frame.bounds.queue_capacity:
                continue
            # The rays of another pass lie where those of this one lay. All of them again if some have not been shown
            # all triangles, else those that wait.
            self.context.records.plan(work.lights, len(passes[0].lights))
            self.prepare(work)
            attempt = 0 if in_parts else 1
            if attempt == 1 and len(passes) > 1:
                self.frame.resume.fill_(1)  # other passes have counted there: of this one the least there can be
            self.project(work, rays.ONCE_MORE if in_parts else rays.PENDING_RAYS)
            unfinished = True
            while unfinished:
                unfinished, done = self._all_parts(work, attempt)
                attempt = min(attempt + 1, 2)
                further += done
        return further

    def _all_parts(self, work: Pass, attempt: int) -> tuple[bool, int]:
        """An attempt, in as many parts as it takes; returns whether rays are left over, and the number of parts."""
        frame = self.frame
        frame.parts_of[work.first].zero_()
        frame.deferred.zero_()
        overflowed, part, parts = False, 0, 1
        while part < parts:
            frame.queue_count_of[work.first].zero_()
            self.trace(replace(work, attempt=attempt, part=part))
            overflowed |= int(frame.queue_count_of[work.first].numpy()[0]) > frame.bounds.queue_capacity
            parts = int(frame.parts_of[work.first].numpy()[0])
            part += 1
        return overflowed or bool(frame.deferred.numpy()[0]), part

    def nbytes(self) -> int:
        """Bytes reserved beyond the buffers, on the device and, for rays that are kept, on the host."""
        return self.pipeline.nbytes() + (self._kept.nbytes() if self._kept is not None else 0)

    def copy_states(self, lights: int, into: npt.NDArray[np.uint8]) -> None:
        """Copy the states for ``lights`` lights into their columns of (L, N) ``into``."""
        frame = self.frame
        states = frame.states_of(0, lights).numpy().reshape(lights, frame.count)
        into[:, frame.first : frame.first + frame.count] = states
