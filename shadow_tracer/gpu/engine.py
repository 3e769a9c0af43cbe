# SPDX-License-Identifier: Apache-2.0
"""One frame on the device: scene and samples in, states out. Owns the buffers; the pipeline finds the occluders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu import light_frame, projection, shadow_test, soft, unproject
from shadow_tracer.gpu.buffers import Change, FrameBuffers, SceneBuffers, upload
from shadow_tracer.gpu.graphs import FrameGraphs
from shadow_tracer.gpu.light_frame import Anchor, make_anchor, make_light_frame
from shadow_tracer.gpu.passes import Pass
from shadow_tracer.gpu.pinhole import make_pinhole
from shadow_tracer.gpu.pipelines import Pipeline, make_pipeline
from shadow_tracer.gpu.stages import Stages
from shadow_tracer.gpu.triangles import Context, TriangleRecords
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import HardLight, Light
from shadow_tracer.scene.mesh import Scene

# Threads that share the queue: enough to fill a GPU, and one on the CPU where threads run one after the other.
_RESOLVERS_CUDA = 65536


@dataclass(frozen=True)
class Traced:
    """Result of a frame: (L, N) uint8 states, milliseconds per stage, counters; for each sphere light by its number
    (N,) how many of its points reach."""

    states: npt.NDArray[np.uint8]
    stages: dict[str, float]
    counters: dict[str, int]
    reached: dict[int, npt.NDArray[np.uint16]] = field(default_factory=dict)


@dataclass
class _Second:
    """The pipeline that is not in use, and the names of the second one."""

    names: tuple[str, str]
    pipeline: Pipeline


class Engine:
    """Device side of a tracer."""

    def __init__(self, device: Any, bounds: Bounds, pipeline: str, variant: str, graphs: bool | None) -> None:
        self.device = device
        self._use_graphs = device.is_cuda if graphs is None else graphs
        self._graphs = FrameGraphs(device)
        self.bounds = bounds
        self.stages = Stages(device)
        self._frame = FrameBuffers(bounds, device)
        self._scene = SceneBuffers(bounds, device)
        self._context = Context(self._frame, self._scene, TriangleRecords(self._frame, self._scene), self.stages)
        self._anchor: Anchor | None = None
        self._pipeline: Pipeline
        self._second: _Second | None = None
        self._seconding = False
        # The worst that has happened to the scene since the first, and the second, pipeline took note.
        self._news = [Change.TOPOLOGY, Change.TOPOLOGY]
        self.select(pipeline, variant)

    def select(self, pipeline: str, variant: str) -> None:
        """Use another pipeline from the next frame on; the old one's buffers are freed, and the second pipeline's if it
        would be the same."""
        if self.second == pipeline:
            self.release_second()
        self._graphs.clear()
        self._context.records.forget()
        self._pipeline = make_pipeline(pipeline, variant, self._context)
        self._news[0] = Change.TOPOLOGY

    @property
    def second(self) -> str | None:
        """Name of the second pipeline, None if there is none."""
        return None if self._second is None else self._second.names[0]

    def employ_second(self, pipeline: str, variant: str) -> None:
        """Allocate the buffers of a second pipeline beside the first; scene, samples and records are shared. One that
        was there before is freed unless it is the same."""
        if self._second is None or self._second.names != (pipeline, variant):
            self.release_second()
            self._second = _Second((pipeline, variant), make_pipeline(pipeline, variant, self._context))
            self._news[1] = Change.TOPOLOGY

    def release_second(self) -> None:
        """Free the second pipeline's buffers, if there are any."""
        self._second = None

    @contextmanager
    def second_opinion(self) -> Iterator[None]:
        """Frames inside are traced by the second pipeline, kernel by kernel, with triangle records made anew."""
        second = self._second
        assert second is not None and not self._seconding
        # Pipelines keep more of a light than its records (corners), and tell by the records whether they have it.
        self._context.records.forget()
        self._pipeline, second.pipeline, self._seconding = second.pipeline, self._pipeline, True
        try:
            yield
        finally:
            self._pipeline, second.pipeline, self._seconding = second.pipeline, self._pipeline, False
            self._context.records.forget()

    @property
    def front_face_culling(self) -> bool:
        """Whether triangles whose front faces the light cast nothing."""
        return self._context.records.front_face_culling

    @front_face_culling.setter
    def front_face_culling(self, value: bool) -> None:
        self._context.records.front_face_culling = value

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        second = self._second.pipeline.nbytes() if self._second is not None else 0
        return self._frame.nbytes() + self._scene.nbytes() + self._pipeline.nbytes() + second

    def holds(self, depth: np.ndarray) -> bool:
        """Whether ``depth`` is, bit for bit, the depth image last traced in its format. Waits for the device."""
        frame, metres = self._frame, depth.dtype == np.float32
        held = (frame.depth_metres if metres else frame.depth_millimetres)[: depth.size].numpy()
        integer = np.uint32 if metres else np.uint16
        return np.array_equal(held.view(integer), depth.reshape(-1).view(integer))  # as bits: NaN equals NaN

    def trace_depth(
        self, scene: Scene, depth: np.ndarray, camera: Camera, lights: Sequence[Light], bias: tuple[float, float]
    ) -> Traced:
        """States of all pixels for all lights. Arguments have been checked: float32 metres or uint16 millimetres, C
        order."""
        self.stages.reset()
        frame = self._frame
        metres = depth.dtype == np.float32
        target = frame.depth_metres if metres else frame.depth_millimetres
        with self.stages.stage("upload"):
            self._sync(scene)
            upload(target, depth.reshape(-1))
        frame.set_samples(depth.size, camera.width)
        self._anchor = _depth_anchor(depth, camera, bias, self._anchor)
        frame.set_camera(make_pinhole(camera, bias))
        self._take_note()
        return self._trace_all(lights, target)

    def trace_points(
        self,
        scene: Scene,
        points: FloatArray,
        lights: Sequence[Light],
        bias: float,
        valid: npt.NDArray[np.bool_] | None = None,
    ) -> Traced:
        """States of (N, 3) finite points, N at most ``bounds.max_rays``; those that are not ``valid`` are INVALID, None
        is all valid."""
        self.stages.reset()
        frame = self._frame
        with self.stages.stage("upload"):
            self._sync(scene)
            samples = np.empty((len(points), 4))
            samples[:, :3] = points
            samples[:, 3] = bias
            upload(frame.samples, samples)
            upload(frame.valid, (np.ones(len(points), np.bool_) if valid is None else valid).view(np.uint8))
        frame.set_samples(len(points), 0)
        seen = points if valid is None or not valid.any() else points[valid]
        low, high = seen.min(axis=0), seen.max(axis=0)
        center = 0.5 * low + 0.5 * high
        self._anchor = make_anchor(center, max(float(np.linalg.norm(high - center)), 4.0 * bias), self._anchor)
        self._take_note()
        return self._trace_all(lights, None)

    def _sync(self, scene: Scene) -> None:
        change = self._scene.sync(scene)
        self._news = [max(before, change) for before in self._news]

    def _take_note(self) -> None:
        self._pipeline.update(self._news[self._seconding])
        self._news[self._seconding] = Change.NOTHING

    def _trace_all(self, lights: Sequence[Light], depth: wp.array | None) -> Traced:
        if not soft.is_soft(lights):
            return self._trace_lights(lights, depth)
        tally = soft.Tally(lights, self._frame.count, self.bounds.max_lights)
        counters: dict[str, int] = {}
        for first, batch in tally.batches():
            traced = self._trace_lights(batch, depth if first == 0 else None)
            tally.add(first, traced.states)
            counters = soft.add_up(counters, traced.counters)
        states, reached = tally.result()
        return Traced(states, traced.stages, counters, reached)

    def _trace_lights(self, lights: Sequence[HardLight], depth: wp.array | None) -> Traced:
        frame = self._frame
        assert self._anchor is not None
        light_frames = [make_light_frame(light, self._anchor, index) for index, light in enumerate(lights)]
        frame.set_lights(light_frames)
        passes = self._passes(light_frames)
        stale = self._context.records.plan(light_frames, len(passes[0].lights))
        if self._use_graphs and self._pipeline.recordable and not self._seconding:
            source = None if depth is None else depth.dtype.__name__
            triangles, vertices = self._scene.triangle_count, self._scene.vertex_count
            key = (source, frame.count, frame.width, triangles, vertices, self.front_face_culling, stale)
            with self.stages.stage("graph"), self.stages.paused():
                self._graphs.run(key, lambda: self._launch(passes, depth))
        else:
            self._launch(passes, depth)
        further = self._finish_overflow(passes)
        with self.stages.stage("download"):
            states = frame.states_of(0, len(lights)).numpy().reshape(len(lights), frame.count).copy()
            counters = frame.read_counters()
        counters["triangles"] = self._scene.triangle_count
        counters["degenerate"], counters["culled"] = self._context.records.silent(len(lights) - 1)
        counters["overflow_passes"] = further + counters.pop("overflows")
        self._pipeline.learn(counters)
        return Traced(states, self.stages.read(), counters)

    def _passes(self, light_frames: Sequence[light_frame.LightFrame]) -> list[Pass]:
        """As many lights together as the pipeline takes and as there is room for."""
        together = min(
            self._pipeline.lights_together,
            len(light_frames),
            self.bounds.max_rays // max(self._frame.count, 1),
            self._context.records.room(),
        )
        return [Pass(tuple(light_frames[first : first + together])) for first in range(0, len(light_frames), together)]

    def _launch(self, passes: Sequence[Pass], depth: wp.array | None) -> None:
        """Everything of a frame between upload and download, further passes aside."""
        frame = self._frame
        frame.counters.zero_()
        frame.queue_counts.zero_()
        frame.parts.zero_()
        if depth is not None:
            with self.stages.stage("unproject"):
                unproject.unproject_image(depth, frame)
        for work in passes:
            self._project(work, projection.FIRST_TIME)
            self._attempt(work)

    def _project(self, work: Pass, again: int) -> None:
        with self.stages.stage("project"):
            for place, light in enumerate(work.lights):
                projection.project(self._frame, light.number, place, again)

    def _attempt(self, work: Pass) -> None:
        if self._scene.triangle_count == 0:
            return
        frame = self._frame
        self._pipeline.trace(work)
        threads = 1 if self.device.is_cpu else min(_RESOLVERS_CUDA, self.bounds.queue_capacity)
        with self.stages.stage("resolve"):
            wp.launch(
                shadow_test.resolve_queue,
                dim=threads,
                inputs=[
                    frame.lights_from(work.first),
                    frame.count,
                    threads,
                    frame.queue,
                    frame.queue_count_of[work.first],
                    frame.samples,
                    self._scene.vertices,
                    self._scene.triangles,
                    frame.states_of(work.first, len(work.lights)),
                    frame.counters,
                ],
                device=self.device,
            )

    def _finish_overflow(self, passes: Sequence[Pass]) -> int:
        """Further passes for lights whose queue overflowed, or whose pipeline had more work than its lists hold. Only
        here the host waits for the device before the result."""
        further = 0
        queued, parts = self._frame.queue_counts.numpy().copy(), self._frame.parts.numpy().copy()
        for work in passes:
            in_parts = parts[work.first] > 1
            if not in_parts and queued[work.first] <= self.bounds.queue_capacity:
                continue
            # The rays of another pass lie where those of this one lay. All of them again if some have not been shown
            # all triangles, else those that wait.
            self._context.records.plan(work.lights, len(passes[0].lights))
            attempt = 0 if in_parts else 1
            self._project(work, projection.ONCE_MORE if in_parts else projection.PENDING_RAYS)
            unfinished = True
            while unfinished:
                unfinished, done = self._all_parts(work, attempt)
                attempt = min(attempt + 1, 2)
                further += done
        return further

    def _all_parts(self, work: Pass, attempt: int) -> tuple[bool, int]:
        """An attempt, in as many parts as it takes; returns whether rays are left over, and the number of parts."""
        frame = self._frame
        frame.parts_of[work.first].zero_()
        frame.deferred.zero_()
        overflowed, part, parts = False, 0, 1
        while part < parts:
            frame.queue_count_of[work.first].zero_()
            self._attempt(replace(work, attempt=attempt, part=part))
            overflowed |= int(frame.queue_count_of[work.first].numpy()[0]) > self.bounds.queue_capacity
            parts = int(frame.parts_of[work.first].numpy()[0])
            part += 1
        return overflowed or bool(frame.deferred.numpy()[0]), part


def _depth_anchor(depth: np.ndarray, camera: Camera, bias: tuple[float, float], previous: Anchor | None) -> Anchor:
    """Anchor from a sparse look at the depth image: it needs to be near the samples, not around all of them."""
    step = max(1, min(depth.shape) // 32)
    rows, columns = np.mgrid[step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step]
    z = depth[rows, columns].astype(np.float64)
    if depth.dtype == np.uint16:
        z /= 1000.0
    seen = np.isfinite(z) & (z > 0.0)
    if not seen.any():
        return previous or make_anchor(camera.position, 1.0, None)
    # A few samples at the end of the world must not make all others small: float32 could not tell them apart. A
    # background is no outlier: it has many.
    seen &= z <= 30.0 * float(np.quantile(z[seen], 0.98))
    z, u, v = z[seen], columns[seen], rows[seen]
    local = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    low, high = local.min(axis=1), local.max(axis=1)
    center = 0.5 * low + 0.5 * high
    world = camera.camera_to_world[:3, :3] @ center + camera.camera_to_world[:3, 3]
    # A scale of some biases keeps the biased starts from cancelling against it (project_samples).
    return make_anchor(
        world, max(float(np.linalg.norm(high - center)), 4.0 * (bias[0] + bias[1] * z.max() ** 2)), previous
    )
