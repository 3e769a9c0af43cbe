# SPDX-License-Identifier: Apache-2.0
"""One frame on the device: scene and samples in, states out. Owns the buffers; the pipeline finds the occluders."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.accelerators.interface import Accelerator, Context
from shadow_tracer.gpu.accelerators.registry import side_by_side
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.graphs import FrameGraphs
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.device.workers import Job, Workers
from shadow_tracer.gpu.engine.automatic import Chooser, Names, Situation
from shadow_tracer.gpu.engine.balance import Balance
from shadow_tracer.gpu.engine.cuts import LEAST, even_cuts
from shadow_tracer.gpu.engine.gather import Traced, gather_counters, gather_stages, gather_states
from shadow_tracer.gpu.engine.share import Share
from shadow_tracer.gpu.engine.spheres import trace_spheres
from shadow_tracer.gpu.exact import light_frame
from shadow_tracer.gpu.exact.light_frame import Anchor, make_light_frame
from shadow_tracer.gpu.occluders.changes import Changed, Revision
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.anchor import depth_anchor, points_anchor
from shadow_tracer.gpu.samples.held import Samples, Source
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.samples.sample_set import FrameBuffers
from shadow_tracer.gpu.visibility import sphere_points
from shadow_tracer.gpu.visibility.packed_states import PackedStates
from shadow_tracer.gpu.visibility.planes import StatePlanes
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import HardLight, Light, SphereLight
from shadow_tracer.scene.mesh import Scene

# Of frames that need the same kernels of a pipeline: what samples are made of (``Source.name``), or that points of
# sphere lights are asked for; and whether there are triangles.
Kind = tuple[str | None, bool]
Loaded = tuple[Names, str | None, bool]
_SPHERES = "spheres"


def kinds_of(source: str | None, lights: Sequence[Light], triangles: bool) -> list[Kind]:
    """What a frame is."""
    return [(source, triangles), *([(_SPHERES, triangles)] if sphere_points.is_soft(lights) else [])]


class FrameTracer:
    """Traces the frames of a set of samples, one after the other, with buffers that are allocated here and never again.
    Rays, cuts and anchor are kept from frame to frame.

    It is thrown away after a frame that did not end (``engine.py``): nothing here has to be right in the middle of one.

    Args:
        scene: the world, which other sets of samples share.
        names: pipeline and variant.
        chooser: who chooses the pipeline of each frame; None if it is always ``names``.
        graphs: whether frames are recorded where the pipeline allows it.
        workers: threads for the shares of the rays that are worked on side by side where the pipeline allows it.
        loaded: which kernels have been launched by this tracer, and by anybody on the device; both are added to.
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
        self._loaded, self._loaded_by_anybody = loaded
        self._cold = False  # whether this frame has loaded kernels, or recorded its launches
        mirrored = not forms.wide(device) or graphs
        self._frame = FrameBuffers(bounds, device, workers.count, mirrored=mirrored)
        self._planes = StatePlanes(self._frame) if mirrored else None
        self._scene, self._synced = scene, Revision()
        records = TriangleRecords(bounds, self._scene, self._frame.light_frame_of, self._frame.host)
        self._context = Context(self._frame, self._scene, records, self.stages)
        self._anchor: Anchor | None = None
        self._lights: tuple[object, ...] = ()
        self._samples = Samples(forms.wide(device) and not graphs)
        self.take(*self.make_teams(names, chooser))

    @property
    def _pipeline(self) -> Accelerator:
        return self._team[0].pipeline

    def make_teams(self, names: Names, chooser: Chooser | None) -> tuple[Chooser | None, dict[Names, list[Share]]]:
        """Allocate the buffers of a pipeline, or of all that ``chooser`` chooses among, beside those in use."""
        teams: dict[Names, list[Share]] = {}
        for each in chooser.candidates if chooser else [names]:
            shares = self._workers.count if side_by_side(*each) else 1
            teams[each] = [Share(self._part(k, shares), *each, not self._use_graphs) for k in range(shares)]
        return chooser, teams

    def take(self, chooser: Chooser | None, teams: dict[Names, list[Share]]) -> None:
        """Use other shares from the next frame on; the old ones are freed."""
        self._chooser, self._teams, self._team = chooser, teams, next(iter(teams.values()))
        self._balances = {names: Balance(len(team)) for names, team in teams.items() if len(team) > 1}
        self._samples.forget()
        self._graphs.clear()
        self._context.records.forget()

    def forget(self) -> None:
        """Make everything again in the next frame."""
        self._samples.make_again()
        self._context.records.forget()

    @property
    def pipelines(self) -> frozenset[str]:
        """Names of the pipelines that may trace a frame: several if one of them is chosen each time."""
        return frozenset(name for name, _ in self._teams)

    def _choose(self, change: int, rays: int, lights: Sequence[Light]) -> Situation | None:
        """Hand the frame to the pipeline that is expected to be the fastest."""
        if self._chooser is None:
            return None
        look = tuple(tuple(light.homogeneous) for light in lights if not isinstance(light, SphereLight))
        count = sum(light.samples if isinstance(light, SphereLight) else 1 for light in lights)
        situation = Situation(change, rays, self._scene.live_triangles, count, look != self._lights)
        self._lights = look
        team = self._teams[self._chooser.choose(situation)]
        if team is not self._team:
            # Each makes its own of a light (corners), and tells by the records whether it has it.
            self._context.records.forget()
            self._team = team
        return situation

    def _learn(self, situation: Situation | None, begin: float) -> None:
        """Tell the chooser what the frame took."""
        if situation is not None and self._chooser is not None:
            self._chooser.learn(self._team[0].names, situation, (time.perf_counter() - begin) * 1e3)

    def _part(self, number: int, shares: int) -> Context:
        """The context of a share; the only one works on the whole."""
        if shares == 1:
            return self._context
        frame = FrameBuffers(self.bounds, self.device, shares, self._frame, number)
        return replace(self._context, frame=frame, stages=Stages(self.device))

    def nbytes(self) -> int:
        """Bytes reserved on the device, the scene aside."""
        own = self._frame.nbytes() + self._context.records.nbytes() + self._context.shared.nbytes()
        own += self._planes.nbytes() if self._planes else 0
        return own + sum(share.nbytes() for share in self._all_shares())

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
            begin, team = time.perf_counter(), self._working(depth.size)
            working = [share for share in team if share.frame.count]
            new = not self._samples.has_depth(self._frames(working), depth, camera, bias)
            if new:  # else the cuts stay where they are, and with them all that is kept of the rays
                working = _deal(team, self._cut(team, depth), camera.width)
                self._samples.put_depth(self._frames(working), depth, camera, bias)
        self._anchor = depth_anchor(depth, camera, bias, self._anchor)
        caught_up = all(share.followed == before for share in working)
        traced = self._trace_all(working, lights, Source.of(depth, bias) if new else None)
        self._learn(situation if caught_up and not self._cold else None, begin)
        if new and not self._cold and len(team) > 1:
            self._balances[team[0].names].learn([share.busy for share in team])
        return traced

    def _cut(self, team: Sequence[Share], depth: np.ndarray) -> list[tuple[int, int]]:
        if len(team) == 1:
            return [(0, depth.size)]
        return self._balances[team[0].names].cut(depth, team[0].frame.bounds.max_rays)

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
            self._choose(self._sync(scene), len(points), lights)
            team = self._working(len(points))
            working = _deal(team, even_cuts(len(points), len(team)), 0)
            self._samples.put_points(self._frames(working), points, bias, valid)
        self._anchor = points_anchor(points, valid, bias, self._anchor)
        return self._trace_all(working, lights, None)

    def _begin_frame(self, cull: bool) -> None:
        """Reset the times of all stages."""
        self._context.records.front_face_culling = cull
        self._cold = False
        for share in self._all_shares():
            share.stages.reset()
            share.busy = 0.0
        self.stages.reset()

    def _working(self, count: int) -> list[Share]:
        """The shares that so many samples are worth: all, or the first alone if it has room for them."""
        few = count < LEAST * len(self._team) and count <= self._team[0].frame.bounds.max_rays
        return self._team[:1] if few else self._team

    @staticmethod
    def _frames(working: Sequence[Share]) -> list[FrameBuffers]:
        return [share.frame for share in working]

    def _all_shares(self) -> list[Share]:
        """Of all pipelines."""
        return [share for team in self._teams.values() for share in team]

    def _sync(self, scene: Scene) -> int:
        """Copy the scene; returns what has changed of it since the last frame: 0 nothing, 1 positions, 2 triangles."""
        before = self._synced
        self._scene.sync(scene)
        self._synced = after = self._scene.revision
        return 0 if after == before else 1 if after.topology == before.topology else 2

    def _trace_all(self, working: list[Share], lights: Sequence[Light], source: Source | None) -> Traced:
        for share in working:
            share.follow()
        if not sphere_points.is_soft(lights):
            return self._trace_lights(working, lights, source)

        def trace(batch: Sequence[HardLight], first: bool) -> Traced:
            return self._trace_lights(working, batch, source if first else None)

        kernels = (working[0].names, _SPHERES, self._scene.triangle_count > 0)
        self._cold |= kernels not in self._loaded
        traced = trace_spheres(working, lights, self.bounds.max_lights, trace, self.stages)
        self._launched(kernels)
        return traced

    def _trace_lights(self, working: list[Share], lights: Sequence[HardLight], source: Source | None) -> Traced:
        """``source``: what samples are to be made of, None if there are some."""
        assert self._anchor is not None
        light_frames = [make_light_frame(light, self._anchor, index) for index, light in enumerate(lights)]
        for frame in {id(frame): frame for frame in (self._frame, *self._frames(working))}.values():
            frame.set_lights(light_frames)
        passes = self._passes(working, light_frames)
        stale = self._context.records.plan(light_frames, len(passes[0].lights))
        self._launch(working, passes, source, stale)
        if self._planes:
            with self.stages.stage("download"):
                self._planes.fetch(len(lights))
        # Further passes may make another light's records in the place of these.
        silent = self._pipeline.silent(light_frames[-1])
        further = sum(share.finish(passes) for share in working)
        with self.stages.stage("download"):
            found = self._found(working, len(lights), further > 0)
            counters = gather_counters(working)
        counters["triangles"] = self._scene.live_triangles
        counters["degenerate"], counters["culled"] = silent
        counters["overflow_passes"] = further + counters.pop("overflows")
        return Traced(found, gather_stages(self.stages, working), counters)

    def _found(self, working: Sequence[Share], lights: int, anew: bool) -> PackedStates | npt.NDArray[np.uint8]:
        """States, of which those of a GPU have been fetched; ``anew``: but have changed since."""
        if not self._planes:
            return gather_states(working, lights)
        if anew:
            self._planes.pack(lights)
            self._planes.fetch(lights)
        return self._planes.read(lights)

    def _passes(self, working: Sequence[Share], light_frames: Sequence[light_frame.LightFrame]) -> list[Pass]:
        """As many lights together as the pipeline takes and as there is room for."""
        together = min(
            self._pipeline.traits.lights_at_once,
            len(light_frames),
            *(share.frame.bounds.max_rays // max(share.frame.count, 1) for share in working),
            self._context.records.room(),
        )
        return [Pass(tuple(light_frames[first : first + together])) for first in range(0, len(light_frames), together)]

    def _launch(
        self, working: list[Share], passes: Sequence[Pass], source: Source | None, stale: Sequence[Changed]
    ) -> None:
        """Everything of a frame between upload and download, further passes aside."""
        first = working[0]
        # Warp loads kernels when they are first launched, and not in two threads at once. Whatever a first frame holds,
        # it needs those of all further ones; but an empty scene needs fewer.
        kernels = (first.names, None if source is None else source.name, self._scene.triangle_count > 0)
        loaded = kernels in self._loaded or (source is None and self._has_launched(first.names))
        self._cold |= not loaded
        if self._use_graphs and first.pipeline.traits.recordable:
            frame, scene, records = first.frame, self._scene, self._context.records
            key = (*kernels[:2], frame.count, frame.width, scene.triangle_count, scene.vertex_count)
            key = (*key, records.places, records.stride)
            stale = self._mend(first, passes, stale)

            def launch() -> None:
                records.expect(stale)
                self._run(working, passes, source, _one_after_the_other)

            with self.stages.stage("graph"), self.stages.paused():
                key = (*key, records.front_face_culling, *map(bool, stale))
                self._cold |= self._graphs.run(key, launch)
        else:
            side_by_side = loaded and len(working) > 1
            self._run(working, passes, source, self._workers.run if side_by_side else _one_after_the_other)
        self._launched(kernels)

    def _launched(self, kernels: Loaded) -> None:
        """These are loaded."""
        self._loaded.add(kernels)
        self._loaded_by_anybody.add(kernels)

    @staticmethod
    def _mend(share: Share, passes: Sequence[Pass], stale: Sequence[Changed]) -> list[Changed]:
        """Make what is to be made of a part of the triangles before what is recorded, which else would be another for
        every part; returns what is left to make. The place of such a light holds its records, so it is that of no light
        before it."""
        left = list(stale)
        for light in (light for work in passes for light in work.lights):
            if left[light.number] and not left[light.number].everything:
                share.aim(Pass((light,)))
                left[light.number] = Changed()
        return left

    def _has_launched(self, names: Names) -> bool:
        """Whether all kernels of a pipeline have been launched, but for those that make samples."""
        return any(kernels[0] == names and kernels[2] == bool(self._scene.triangle_count) for kernels in self._loaded)

    def _run(
        self,
        working: Sequence[Share],
        passes: Sequence[Pass],
        source: Source | None,
        run: Callable[[Sequence[Job]], None],
    ) -> None:
        """The order of a frame: of each pass first what one share makes for all of them."""
        for number, work in enumerate(passes):
            working[0].aim(work)

            def job(share: Share, work: Pass = work, first: bool = number == 0) -> None:
                begin = time.perf_counter()
                if first:
                    share.begin(source)
                share.project(work)
                share.trace(work)
                share.busy += time.perf_counter() - begin

            run([partial(job, share) for share in working])
        if self._planes:
            with self.stages.stage("download"):
                self._planes.pack(sum(len(work.lights) for work in passes))


def _deal(team: Sequence[Share], cuts: Sequence[tuple[int, int]], width: int) -> list[Share]:
    """Tell each share its samples; returns those that have any."""
    for share, (first, end) in zip(team, cuts, strict=True):
        share.frame.set_samples(end - first, width, first)
    return [share for share in team if share.frame.count]


def _one_after_the_other(jobs: Sequence[Job]) -> None:
    for job in jobs:
        job()
