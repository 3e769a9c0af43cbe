# SPDX-License-Identifier: Apache-2.0
"""One frame on the device: scene and samples in, states out. Owns the buffers; the pipeline finds the occluders."""

from __future__ import annotations

import time
from collections.abc import Hashable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.registry import side_by_side
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.graphs import FrameGraphs
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.device.workers import Workers, one_after_the_other
from shadow_tracer.gpu.engine.apart import Apart, trace_beside
from shadow_tracer.gpu.engine.area_lights import Run, trace_area_lights
from shadow_tracer.gpu.engine.automatic import Chooser
from shadow_tracer.gpu.engine.band import Band, deal
from shadow_tracer.gpu.engine.bands import LEAST, balances, even_bands
from shadow_tracer.gpu.engine.costs import Names, Situation, counted
from shadow_tracer.gpu.engine.gather import Traced, gather_counters, gather_stages, gather_states
from shadow_tracer.gpu.exact import light_frame
from shadow_tracer.gpu.exact.light_frame import Anchor, make_light_frame
from shadow_tracer.gpu.occluders.changes import Changed, Revision
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.anchor import depth_anchor, points_anchor
from shadow_tracer.gpu.samples.held import Samples, Source
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.gpu.visibility import light_points
from shadow_tracer.gpu.visibility.packed_states import PackedStates
from shadow_tracer.gpu.visibility.planes import StatePlanes
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import AreaLight, HardLight, Light
from shadow_tracer.scene.mesh import Scene

# Of frames that need the same kernels of a pipeline: what samples are made of (``Source.name``), or that points of
# lights with size are asked for; and whether there are triangles.
Kind = tuple[str | None, bool]
Loaded = tuple[Names, str | None, bool]
_POINTS = "points of lights"


def kinds_of(source: str | None, lights: Sequence[Light], triangles: bool) -> list[Kind]:
    """What a frame is."""
    return [(source, triangles), *([(_POINTS, triangles)] if light_points.is_soft(lights) else [])]


class FrameTracer:
    """Traces the frames of a set of samples, one after the other, with buffers that are allocated here and never again.
    Rays, cuts and anchor are kept from frame to frame.

    It is thrown away after a frame that did not end (``engine.py``): nothing here has to be right in the middle of one.

    Args:
        scene: the world, which other sets of samples share.
        names: pipeline and variant.
        chooser: who chooses the pipeline of each frame; None if it is always ``names``.
        graphs: whether frames are recorded where the pipeline allows it.
        workers: threads for the bands of the rays that are worked on side by side where the pipeline allows it.
        loaded: which kernels have been launched by this tracer, and on the device at all; both are added to.
    """

    def __init__(
        self,
        device: Any,
        bounds: Bounds,
        scene: SceneBuffers,
        names: Names,
        chooser: Chooser | None,
        graphs: bool,
        workers: Workers,
        loaded: tuple[set[Loaded], set[Hashable]],
    ) -> None:
        self.device = device
        self.bounds = bounds
        self.stages = Stages(device)
        self._use_graphs = graphs
        self._graphs = FrameGraphs(device)
        self._workers = workers
        self._loaded, self._loaded_at_all = loaded
        self._cold = False  # whether this frame has loaded kernels, or recorded its launches
        mirrored = not forms.wide(device) or graphs
        self._whole = SampleSet(bounds, device, workers.count, mirrored=mirrored)
        self._planes = StatePlanes(self._whole) if mirrored else None
        self._scene, self._synced = scene, Revision()
        records = TriangleRecords(bounds, self._scene, self._whole.light_frame_of, self._whole.host)
        self._context = Context(self._whole, self._scene, records, self.stages, workers=workers)
        self._anchor: Anchor | None = None
        self._lights: tuple[object, ...] = ()
        self._samples = Samples(forms.wide(device) and not graphs, workers)
        self.take(*self.make_bands(names, chooser))

    def make_bands(self, names: Names, chooser: Chooser | None) -> tuple[Chooser | None, dict[Names, list[Band]]]:
        """Allocate the buffers of a pipeline, or of all that ``chooser`` chooses among, beside those in use."""
        bands_of: dict[Names, list[Band]] = {}
        for each in chooser.candidates if chooser else [names]:
            bands = self._workers.count if side_by_side(*each) else 1
            bands_of[each] = [Band(self._part(k, bands), *each, not self._use_graphs) for k in range(bands)]
        return chooser, bands_of

    def take(self, chooser: Chooser | None, bands_of: dict[Names, list[Band]]) -> None:
        """Use other bands from the next frame on; the old ones are freed."""
        self._chooser, self._bands_of, self._bands = chooser, bands_of, next(iter(bands_of.values()))
        self._balances = balances(bands_of)
        self._apart = Apart(self.device, self._use_graphs)
        self._samples.forget()
        self._graphs.clear()
        self._context.records.forget()

    def forget(self) -> None:
        """Make everything again in the next frame, as if it were the first."""
        self._samples.make_again()
        self._anchor = None
        self._balances = balances(self._bands_of)
        self._context.records.forget()
        for band in self._all_bands():
            band.pipeline.forget()

    @property
    def pipelines(self) -> frozenset[str]:
        """Names of the pipelines that may trace a frame: several if one of them is chosen each time."""
        return frozenset(name for name, _ in self._bands_of)

    def _choose(self, change: int, rays: int, lights: Sequence[Light], listed: bool = False) -> Situation | None:
        """Hand the frame to the pipeline that is expected to be the fastest."""
        if self._chooser is None:
            return None
        look = tuple(tuple(light.homogeneous) for light in lights if not isinstance(light, AreaLight))
        count = sum(light.samples if isinstance(light, AreaLight) else 1 for light in lights)
        situation = Situation(change, rays, self._scene.live_triangles, count, look != self._lights, listed)
        self._lights = look
        bands = self._bands_of[self._chooser.choose(situation)]
        if bands is not self._bands:
            # Each makes its own of a light (corners), and tells by the records whether it has it.
            self._context.records.forget()
            self._bands = bands
        return situation

    def _learn(self, frame: Situation, lights: Sequence[Light], traced: Traced, begin: float | None = None) -> None:
        """Tell the chooser what a frame cost: by its counts where these say it, else since when, if that is known."""
        assert self._chooser is not None
        names = self._bands[0].names
        if forms.wide(self.device) and not light_points.is_soft(lights):
            self._chooser.learn(names, frame, counted(names, frame, traced.counters))
        elif begin is not None:
            self._chooser.learn(names, frame, (time.perf_counter() - begin) * 1e3)

    def _part(self, number: int, bands: int) -> Context:
        """The context of a band; the only one works on the whole."""
        if bands == 1:
            return self._context
        samples = SampleSet(self.bounds, self.device, bands, self._whole, number)
        return replace(self._context, samples=samples, stages=Stages(self.device))

    def nbytes(self) -> int:
        """Bytes reserved on the device, the scene aside."""
        own = self._whole.nbytes() + self._context.records.nbytes() + self._context.shared.nbytes()
        own += self._planes.nbytes() if self._planes else 0
        return own + sum(band.nbytes() for band in self._all_bands())

    def holds(self, depth: np.ndarray) -> bool:
        """Whether ``depth`` is, bit for bit, the depth image last traced, whatever points have been asked for since.
        Waits for the device."""
        return self._samples.holds(depth)

    def trace_depth(
        self, scene: Scene, depth: np.ndarray, camera: Camera, lights: Sequence[Light], bias: Bias, cull: bool = False
    ) -> Traced:
        """States of all pixels for all lights. Arguments have been checked: float32 metres or uint16 millimetres, C
        order; ``cull``: triangles whose front faces the light cast nothing."""
        self._begin_frame(cull)
        before = self._synced
        with self.stages.stage("upload"):
            situation = self._choose(self._sync(scene), depth.size, lights)
            begin, bands = time.perf_counter(), self._working(depth.size)
            working = [band for band in bands if band.samples.count]
            new = not self._samples.has_depth(self._sets(working), depth, camera, bias)
            if new:  # else the cuts stay where they are, and with them all that is kept of the rays
                working = deal(bands, self._cut(bands, depth), camera.width)
                self._samples.put_depth(self._sets(working), depth, camera, bias)
        self._anchor = depth_anchor(depth, camera, bias, self._anchor)
        caught_up = all(band.followed == before for band in working)
        traced = self._trace_all(working, lights, Source.of(depth, bias) if new else None)
        if situation:
            self._learn(situation, lights, traced, begin if caught_up and not self._cold else None)
        if new and not self._cold and len(bands) > 1:
            self._balances[bands[0].names].learn([band.busy for band in bands])
        return traced

    def _cut(self, bands: Sequence[Band], depth: np.ndarray) -> list[tuple[int, int]]:
        if len(bands) == 1:
            return [(0, depth.size)]
        return self._balances[bands[0].names].cut(depth, bands[0].samples.bounds.max_rays)

    def trace_points(
        self,
        scene: Scene,
        points: FloatArray,
        lights: Sequence[Light],
        bias: float,
        valid: npt.NDArray[np.bool_] | None = None,
        cull: bool = False,
    ) -> Traced:
        """States of (N, 3) finite points, N at most ``bounds.max_rays``; those that are not ``valid`` are INVALID, None
        is all valid; ``cull`` as for ``trace_depth``."""
        self._begin_frame(cull)
        with self.stages.stage("upload"):
            situation = self._choose(self._sync(scene), len(points), lights, True)
            bands = self._working(len(points))
            working = deal(bands, even_bands(len(points), len(bands)), 0)
            before, self._anchor = self._anchor, None  # that of samples that are there, or none
            known = self._samples.put_points(self._sets(working), points, bias, valid)
        self._anchor = before if known and before else points_anchor(points, valid, bias, before)
        traced = self._trace_all(working, lights, None)
        if situation:
            self._learn(situation, lights, traced)
        return traced

    def _begin_frame(self, cull: bool) -> None:
        """Reset the times of all stages."""
        self._context.records.front_face_culling = cull
        self._cold = False
        for band in self._all_bands():
            band.stages.reset()
            band.busy = 0.0
        self.stages.reset()

    def _working(self, count: int) -> list[Band]:
        """The bands that so many samples are worth: all, or the first alone if it has room for them."""
        few = count < LEAST * len(self._bands) and count <= self._bands[0].samples.bounds.max_rays
        return self._bands[:1] if few else self._bands

    @staticmethod
    def _sets(working: Sequence[Band]) -> list[SampleSet]:
        return [band.samples for band in working]

    def _all_bands(self) -> list[Band]:
        """Of all pipelines."""
        return [*(band for bands in self._bands_of.values() for band in bands), *self._apart.bands()]

    def _sync(self, scene: Scene) -> int:
        """Copy the scene; returns what has changed of it since the last frame: 0 nothing, 1 positions, 2 triangles."""
        before = self._synced
        self._scene.sync(scene)
        self._synced = after = self._scene.revision
        return 0 if after == before else 1 if after.topology == before.topology else 2

    def _trace_all(self, working: list[Band], lights: Sequence[Light], source: Source | None) -> Traced:
        for band in working:
            band.follow()
        soft = light_points.is_soft(lights)
        if not soft and not any(map(light_points.ignored_by, lights)):
            return self._trace_lights(working, lights, source)

        kernels = (working[0].names, _POINTS, self._scene.triangle_count > 0)
        loaded = kernels in self._loaded
        self._cold |= soft and not loaded
        beside = self._apart.of(working) if soft else working

        def trace(batch: light_points.Batch) -> Traced:
            def others() -> Traced:
                return self._trace_lights(beside, batch.lights, None)

            if batch.apart and beside is not working:
                return trace_beside(beside, working, self._context.records, others)
            traced = self._trace_lights(working, batch.lights, None if batch.first else source, batch.hidden)
            if soft and not loaded and beside is not working:  # so that their kernels are loaded, too
                trace_beside(beside, working, self._context.records, others)
            return traced

        run, whole = self._runner(working, loaded), self.stages
        together, one_by_one = self.bounds.max_lights, beside[0].pipeline
        traced = trace_area_lights(working, self._scene, lights, together, trace, one_by_one, run, whole)
        if soft:
            self._launched(kernels)
        return traced

    def _trace_lights(
        self, working: list[Band], lights: Sequence[HardLight], source: Source | None, hidden: bool = True
    ) -> Traced:
        """``source``: what samples are to be made of, None if there are some; ``hidden``: whether what is hidden from
        the lights is asked, or only where they shine."""
        assert self._anchor is not None
        light_frames = [make_light_frame(light, self._anchor, index) for index, light in enumerate(lights)]
        for samples in {id(samples): samples for samples in (self._whole, *self._sets(working))}.values():
            samples.set_lights(light_frames)
        passes = self._passes(working, light_frames)
        stale = self._context.records.plan(light_frames, len(passes[0].lights))
        self._launch(working, passes, source, stale, hidden)
        if self._planes:
            with self.stages.stage("download"):
                self._planes.fetch(len(lights))
        # Further passes may make another light's records in the place of these.
        silent = working[0].pipeline.silent(light_frames[-1])
        further = sum(band.finish(passes) for band in working)
        with self.stages.stage("download"):
            found = self._found(working, len(lights), further > 0)
            counters = gather_counters(working)
        counters["triangles"] = self._scene.live_triangles
        counters["degenerate"], counters["culled"] = silent
        counters["overflow_passes"] = further + counters.pop("overflows")
        return Traced(found, gather_stages(self.stages, working), counters)

    def _found(self, working: Sequence[Band], lights: int, changed: bool) -> PackedStates | npt.NDArray[np.uint8]:
        """States, of which those of a GPU have been fetched; ``changed``: but not as they are now."""
        if not self._planes:
            return gather_states(working, lights)
        if changed:
            self._planes.pack(lights)
            self._planes.fetch(lights)
        return self._planes.read(lights)

    def _passes(self, working: Sequence[Band], light_frames: Sequence[light_frame.LightFrame]) -> list[Rays]:
        """As many lights together as the pipeline takes and as there is room for; of the pass of a frame that has but
        one the rays may be kept."""
        traits, count = working[0].pipeline.traits, max(1, *(band.samples.count for band in working))
        together = min(traits.lights_at_once, len(light_frames), self._context.records.room())
        together = min(together, *(band.samples.bounds.max_rays // max(band.samples.count, 1) for band in working))
        again = [band.asked_again(light_frames) for band in working]
        if not all(again):
            together = min(together, max(1, traits.rays_at_once // count))
        keep = together == len(light_frames)
        firsts = range(0, len(light_frames), together)
        return [Rays(tuple(light_frames[first : first + together]), keep) for first in firsts]

    def _launch(
        self, working: list[Band], passes: Sequence[Rays], source: Source | None, stale: Sequence[Changed], hidden: bool
    ) -> None:
        """Everything of a frame between upload and download, further passes aside."""
        first = working[0]
        # Warp loads kernels when they are first launched, and not in two threads at once. Whatever a first frame holds,
        # it needs those of all further ones; but an empty scene needs fewer.
        kernels = (first.names, None if source is None else source.name, self._scene.triangle_count > 0)
        loaded = kernels in self._loaded or (source is None and self._has_launched(first.names))
        self._cold |= not loaded
        load = not loaded and not hidden  # so that those that trace are loaded, too
        if self._use_graphs and first.pipeline.traits.recordable:
            samples, scene, records = first.samples, self._scene, self._context.records
            key = (*kernels[:2], samples.count, samples.width, scene.triangle_count, scene.vertex_count)
            key = (*key, records.places, records.stride, hidden)
            stale = self._mend(first, passes, stale)
            for band in working:
                band.pipeline.arrange()

            def launch() -> None:
                records.expect(stale)
                self._run(working, passes, source, one_after_the_other, hidden, load)

            with self.stages.stage("graph"), self.stages.paused():
                key = (*key, records.front_face_culling, *map(bool, stale))
                self._cold |= self._graphs.run(key, launch)
        else:
            self._run(working, passes, source, self._runner(working, loaded), hidden, load)
        self._launched(kernels)

    def _runner(self, working: Sequence[Band], loaded: bool) -> Run:
        """Who does the jobs of the bands; ``loaded``: all kernels that they launch."""
        return self._workers.run if loaded and len(working) > 1 else one_after_the_other

    def _launched(self, kernels: Loaded) -> None:
        """These are loaded."""
        self._loaded.add(kernels)
        self._loaded_at_all.add(kernels)

    @staticmethod
    def _mend(band: Band, passes: Sequence[Rays], stale: Sequence[Changed]) -> list[Changed]:
        """Make what is to be made of a part of the triangles before what is recorded, which else would be another for
        every part; returns what is left to make. The place of such a light holds its records, so it is that of no light
        before it."""
        left = list(stale)
        for light in (light for rays in passes for light in rays.lights):
            if left[light.number] and not left[light.number].everything:
                band.aim((light,))
                left[light.number] = Changed()
        return left

    def _has_launched(self, names: Names) -> bool:
        """Whether all kernels of a pipeline have been launched, but for those that make samples."""
        return any(kernels[0] == names and kernels[2] == bool(self._scene.triangle_count) for kernels in self._loaded)

    def _run(
        self,
        working: Sequence[Band],
        passes: Sequence[Rays],
        source: Source | None,
        run: Run,
        hidden: bool,
        load: bool,
    ) -> None:
        """The order of a frame: of each pass first what one band makes for all of them. ``load``: trace what need not
        be traced, uncounted, as its kernels are not loaded."""
        for number, rays in enumerate(passes):
            working[0].aim(rays.lights)

            def job(band: Band, rays: Rays = rays, first: bool = number == 0) -> None:
                begin = time.thread_time()
                if first:
                    band.begin(source)
                band.project(rays, not hidden)
                if hidden:
                    band.trace(rays)
                elif load:
                    band.trace_uncounted(rays)
                band.busy += time.thread_time() - begin

            run([partial(job, band) for band in working])
        if self._planes:
            with self.stages.stage("download"):
                self._planes.pack(sum(len(rays.lights) for rays in passes))
