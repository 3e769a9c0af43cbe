# SPDX-License-Identifier: Apache-2.0
"""Some rows of the samples of a frame, or all, and the pipeline that works on their rays: from depth to states.

Several bands work side by side (``workers.py``). What they have in common, the scene and what is made of it for a
light, is made before and only read; everything they write is their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays
from shadow_tracer.gpu.accelerators.registry import make_pipeline
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import COUNTERS
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.exact import mask_range
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.samples import normals, pixels
from shadow_tracer.gpu.samples.held import Source, depth_of
from shadow_tracer.gpu.samples.kept_rays import KeptRays
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.gpu.visibility.queries import ANY_HIT, MASK, MASK_BINS, MASK_POINTS, Mask
from shadow_tracer.gpu.visibility.queue import Pending, WaitingPairs
from shadow_tracer.scene.checks import FloatArray


class Band:
    """Rays and who finds their occluders.

    Args:
        keep: whether rays may be taken again while neither samples nor lights change.

    Attributes:
        samples: what they are rays of.
        names: pipeline and variant.
        pipeline: it.
        followed: the revision of the scene that the pipeline has followed last, None if there is none yet.
        busy: seconds of a processor that a frame's rays have taken, set to zero by whoever begins one.
    """

    def __init__(self, context: Context, pipeline: str, variant: str, keep: bool = False) -> None:
        self.context = context
        self.samples: SampleSet = context.samples
        self.names = (pipeline, variant)
        self.pipeline: Accelerator = make_pipeline(pipeline, variant, context)
        self.followed: Revision | None = None
        self.busy = 0.0
        self._kept = KeptRays(self.samples) if keep and self.pipeline.traits.keeps_rays else None
        self._again = False
        self._asked: tuple[int, Sequence[LightFrame]] = (-1, ())
        bounds, device = self.samples.bounds, self.samples.device
        # Of a light that a mask is asked for.
        self._points = wp.empty(
            MASK_POINTS if MASK in self.pipeline.traits.queries else 0, dtype=wp.vec4d, device=device
        )
        self._offsets = wp.empty(
            3 * MASK_POINTS if len(self._points) and forms.wide(device) else 0, dtype=float, device=device
        )
        self._beyond = wp.empty(2 * MASK_BINS if len(self._offsets) else 0, dtype=wp.uint64, device=device)
        self._waiting = None if forms.wide(device) else WaitingPairs(bounds.max_rays, bounds.queue_capacity, device)

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
        samples = self.samples
        samples.clear(samples.counters, samples.queue_counts, samples.parts)
        if source is not None:
            depth = depth_of(samples, source.format)
            with self.stages.stage("unproject"):
                pixels.unproject_image(samples.mine(depth), samples)
                if source.normals:
                    normals.displace(depth, samples)

    def asked_again(self, lights: Sequence[LightFrame]) -> bool:
        """Whether samples and lights are those of the call before: what is made of their rays may be worth keeping."""
        revision, before = self._asked
        self._asked = self.samples.revision, lights
        same = len(lights) == len(before) and all(one is other for one, other in zip(lights, before, strict=True))
        return same and revision == self.samples.revision

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Make what depends on scene and lights alone. It belongs to all bands: one of them does it."""
        if self.context.scene.triangle_count:
            self.pipeline.aim(lights)

    def project(self, rays: Rays, counted: bool = False) -> None:
        """Rays of the samples, unless they are there from the frame before; ``counted``: not to be counted."""
        self._again = self._kept is not None and self._kept.recall(rays.lights)
        if self._again:
            return
        if self._kept is None:
            self.samples.renew()  # the rays of another band in the same buffers are overwritten
        elif not rays.keep:
            self._kept.forget()
        before = self._kept.rays_so_far() if self._kept is not None and rays.keep and rays.first else 0
        self.pipeline.project(rays, counted)
        if self._kept is not None and rays.keep:
            self._kept.keep(rays.lights, before)

    def trace(self, rays: Rays) -> None:
        """Find their occluders."""
        if self.context.scene.triangle_count == 0:
            return
        keep = self._kept is not None and rays.keep
        self.pipeline.show(replace(rays, keep=keep, again=self._again), ANY_HIT)
        if self._kept is not None and keep:
            self._kept.structured()
        self._decide(rays)

    def trace_uncounted(self, rays: Rays) -> None:
        """The same, and counters are as they were."""
        before = self.samples.counters.numpy().copy()
        self.trace(rays)
        self.samples.counters.assign(before)

    def _decide(self, rays: Rays) -> None:
        """Decide the pairs that wait."""
        if self._waiting is None:
            return
        context, samples, lights = self.context, self.samples, len(rays.lights)

        def pending() -> Pending:
            counts = lights * samples.count, context.records.stride, context.scene.triangle_count
            return Pending(context.answers(rays), *counts, samples.rays, context.records.of(rays.first, lights))

        with self.stages.stage("resolve"):
            self._waiting.decide(context.key(rays), pending)

    def finish(self, passes: Sequence[Rays]) -> int:
        """Further passes for lights of which a list of the pipeline could not hold all, as the host has fetched;
        returns how many. Only here it waits for the device before the result."""
        samples, further = self.samples, 0
        parts = samples.host.read(samples.parts).copy()
        for rays in passes:
            if parts[rays.first] <= 1:
                continue
            # Another pass may have put its rays and records where those of this one lay.
            self.context.records.plan(rays.lights, len(passes[0].lights))
            self.aim(rays.lights)
            self.pipeline.project(rays, counted=True)
            queue_count = samples.queue_count_of[rays.first]
            queue_count.zero_()
            for _ in self.pipeline.more(rays):
                self._decide(rays)
                queue_count.zero_()
                further += 1
        return further

    def see(self, place: int, points: FloatArray) -> tuple[npt.NDArray[np.uint64], dict[str, int]]:
        """Which of (P, 4) homogeneous points of a light each sample sees, as bits, and counters; asked by the samples
        that the light at ``place`` of the batch, which has just been traced, shines on: of others the bits mean
        nothing."""
        if self.context.scene.triangle_count == 0:
            return np.full(self.samples.count, (1 << len(points)) - 1, np.uint64), {}
        return self._ask(place, points, 1)[: self.samples.count].numpy(), self._counted()

    def try_out(self, place: int, points: FloatArray, every: int) -> dict[str, int]:
        """The counters of ``see`` if only one in so many samples asks."""
        if self.context.scene.triangle_count == 0:
            return {}
        self._ask(place, points, every)
        return self._counted()

    def _ask(self, place: int, points: FloatArray, every: int) -> wp.array:
        samples, scene, records = self.samples, self.context.scene, self.context.records
        asked = Mask()
        asked.count, asked.points, asked.every = len(points), self._points, every
        asked.samples, asked.width = samples.count, samples.width
        samples.upload(self._points, points)
        asked.middle, asked.extent, offsets = _bundle(points)
        asked.offsets, asked.beyond = self._offsets, self._beyond
        if len(self._offsets):
            samples.upload(self._offsets, _padded(offsets))
            sides = mask_range.sides_of(offsets)
            if sides:
                asked.ranges, asked.radius = 1, sides.radius
                asked.u, asked.v = wp.vec3d(*sides.u), wp.vec3d(*sides.v)
                samples.upload(self._beyond, sides.beyond.reshape(-1))
        asked.positions, asked.states, asked.seen = samples.positions, samples.states_of(place), samples.seen
        asked.vertices, asked.triangles, asked.triangle_count = scene.vertices, scene.triangles, scene.triangle_count
        asked.cull, asked.counters = int(records.front_face_culling), samples.counters
        samples.clear(samples.counters)
        self.pipeline.show(Rays((), mask=asked), MASK)
        return asked.seen

    def _counted(self) -> dict[str, int]:
        rows = self.samples.counters.numpy().sum(axis=0)
        return dict(zip(COUNTERS, (int(value) for value in rows), strict=True))

    def nbytes(self) -> int:
        """Bytes reserved beyond the buffers, on the device and, for rays that are kept, on the host."""
        own = self._kept.nbytes() if self._kept is not None else 0
        own += int(self._points.capacity + self._offsets.capacity + self._beyond.capacity)
        own += self._waiting.nbytes() if self._waiting is not None else 0
        return self.pipeline.nbytes() + own

    def copy_states(self, lights: int, into: npt.NDArray[np.uint8]) -> None:
        """Copy the states for ``lights`` lights into their columns of (L, N) ``into``."""
        samples = self.samples
        states = samples.views(samples.states_of(0, lights)).reshape(lights, samples.count)
        into[:, samples.first : samples.first + samples.count] = states


def deal(bands: Sequence[Band], cuts: Sequence[tuple[int, int]], width: int) -> list[Band]:
    """Tell each band its samples; returns those that have any."""
    for band, (first, end) in zip(bands, cuts, strict=True):
        band.samples.set_samples(end - first, width, first)
    return [band for band in bands if band.samples.count]


def _bundle(points: FloatArray) -> tuple[wp.vec4d, wp.vec3d, FloatArray]:
    """Of (P, 4) homogeneous points their middle, how far they are from there along each axis at most [m], and how far
    each is. At infinity, a way of length 1, and how far the ends of the others, as long as they reach the plane across
    its end, are from it."""
    ends, w = points[:, :3], points[0, 3]
    if w != 0.0:
        middle = 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    else:
        ways = ends / np.linalg.norm(ends, axis=1)[:, None]
        middle = ways.sum(axis=0)
        middle /= np.linalg.norm(middle)
        ends = ways / (ways @ middle)[:, None]
    # The middle is off by some roundings.
    extent = np.abs(ends - middle).max(axis=0) * (1.0 + 1e-9) + 1e-14 * np.abs(ends).max()
    return wp.vec4d(*middle, w), wp.vec3d(*extent), ends - middle


def _padded(offsets: FloatArray) -> npt.NDArray[np.float32]:
    """Along x, y and z, as the filter has them."""
    held = np.zeros((3, MASK_POINTS), np.float32)
    held[:, : len(offsets)] = offsets.T
    return held.reshape(-1)
