# SPDX-License-Identifier: Apache-2.0
"""One frame on the device: scene and samples in, states out. Owns the buffers; the pipeline finds the occluders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu import light_frame, projection, shadow_test, unproject
from shadow_tracer.gpu.buffers import FrameBuffers, SceneBuffers, upload
from shadow_tracer.gpu.graphs import FrameGraphs
from shadow_tracer.gpu.light_frame import Anchor, make_anchor, make_light_frame
from shadow_tracer.gpu.pinhole import make_pinhole
from shadow_tracer.gpu.pipelines import Pipeline, make_pipeline
from shadow_tracer.gpu.stages import Stages
from shadow_tracer.gpu.triangles import Context, TriangleRecords
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.mesh import Scene

# Threads that share the queue: enough to fill a GPU, and one on the CPU where threads run one after the other.
_RESOLVERS_CUDA = 65536


@dataclass(frozen=True)
class Traced:
    """Result of a frame: (L, N) uint8 states, milliseconds per stage, counters."""

    states: npt.NDArray[np.uint8]
    stages: dict[str, float]
    counters: dict[str, int]


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
        self.select(pipeline, variant)

    def select(self, pipeline: str, variant: str) -> None:
        """Use another pipeline from the next frame on; the old one's buffers are freed."""
        self._graphs.clear()
        self._context.records.forget()
        self._pipeline = make_pipeline(pipeline, variant, self._context)

    @property
    def front_face_culling(self) -> bool:
        """Whether triangles whose front faces the light cast nothing."""
        return self._context.records.front_face_culling

    @front_face_culling.setter
    def front_face_culling(self, value: bool) -> None:
        self._context.records.front_face_culling = value

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        return self._frame.nbytes() + self._scene.nbytes() + self._pipeline.nbytes()

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
            change = self._scene.sync(scene)
            upload(target, depth.reshape(-1))
        frame.count = depth.size
        frame.width = camera.width
        self._anchor = _depth_anchor(depth, camera, bias, self._anchor)
        frame.set_camera(make_pinhole(camera, bias))
        self._pipeline.update(change)
        return self._trace_lights(lights, target)

    def trace_points(self, scene: Scene, points: FloatArray, light: Light, bias: float) -> Traced:
        """States of (N, 3) points, N at most ``bounds.max_rays``."""
        self.stages.reset()
        frame = self._frame
        with self.stages.stage("upload"):
            change = self._scene.sync(scene)
            samples = np.empty((len(points), 4))
            samples[:, :3] = points
            samples[:, 3] = bias
            upload(frame.samples, samples)
            upload(frame.valid, np.ones(len(points), dtype=np.uint8))
        frame.count = len(points)
        frame.width = 0
        low, high = points.min(axis=0), points.max(axis=0)
        center = 0.5 * low + 0.5 * high
        self._anchor = make_anchor(center, max(float(np.linalg.norm(high - center)), 4.0 * bias), self._anchor)
        self._pipeline.update(change)
        return self._trace_lights([light], None)

    def _trace_lights(self, lights: Sequence[Light], depth: wp.array | None) -> Traced:
        frame = self._frame
        assert self._anchor is not None
        light_frames = [make_light_frame(light, self._anchor, index) for index, light in enumerate(lights)]
        frame.set_lights(light_frames)
        stale = self._context.records.plan(light_frames)
        if self._use_graphs and self._pipeline.recordable:
            source = None if depth is None else depth.dtype.__name__
            triangles, vertices = self._scene.triangle_count, self._scene.vertex_count
            key = (source, frame.count, frame.width, triangles, vertices, self.front_face_culling, stale)
            with self.stages.stage("graph"), self.stages.paused():
                self._graphs.run(key, lambda: self._launch(light_frames, depth))
        else:
            self._launch(light_frames, depth)
        passes = self._finish_overflow(light_frames)
        with self.stages.stage("download"):
            states = np.stack([state[: frame.count].numpy() for state in frame.states[: len(lights)]])
            counters = frame.read_counters()
        counters["triangles"] = self._scene.triangle_count
        counters["degenerate"] = int(frame.degenerate.numpy().sum()) if self._scene.triangle_count else 0
        counters["culled"] = self._context.records.culled if self._scene.triangle_count else 0
        counters["overflow_passes"] = passes
        self._pipeline.learn(counters)
        return Traced(states, self.stages.read(), counters)

    def _launch(self, light_frames: Sequence[light_frame.LightFrame], depth: wp.array | None) -> None:
        """Everything of a frame between upload and download, further passes aside."""
        frame = self._frame
        frame.counters.zero_()
        frame.queue_counts.zero_()
        if depth is not None:
            with self.stages.stage("unproject"):
                unproject.unproject_image(depth, frame)
        for light in light_frames:
            with self.stages.stage("project"):
                projection.project(frame, light.number, 0)
            self._attempt(light, light.number, 0)

    def _attempt(self, light: light_frame.LightFrame, index: int, attempt: int) -> None:
        if self._scene.triangle_count == 0:
            return
        frame = self._frame
        self._pipeline.trace(light, index, attempt)
        threads = 1 if self.device.is_cpu else min(_RESOLVERS_CUDA, self.bounds.queue_capacity)
        with self.stages.stage("resolve"):
            wp.launch(
                shadow_test.resolve_queue,
                dim=threads,
                inputs=[
                    frame.light_frame_of[index],
                    threads,
                    frame.queue,
                    frame.queue_count_of[index],
                    frame.samples,
                    self._scene.vertices,
                    self._scene.triangles,
                    frame.states[index],
                    frame.counters,
                ],
                device=self.device,
            )

    def _finish_overflow(self, light_frames: Sequence[light_frame.LightFrame]) -> int:
        """Further passes for lights whose queue overflowed. Only here the host waits for the device before the
        result."""
        frame, passes = self._frame, 0
        counts = frame.queue_counts.numpy()[: len(light_frames)].copy()
        for index in np.flatnonzero(counts > self.bounds.queue_capacity):
            light = light_frames[index]
            self._context.records.plan([light])
            with self.stages.stage("project"):
                projection.project(frame, int(index), 1)
            attempt, overflowed = 1, True
            while overflowed:
                frame.queue_count_of[index].zero_()
                frame.deferred.zero_()
                self._attempt(light, int(index), attempt)
                queued = int(frame.queue_count_of[index].numpy()[0])
                overflowed = queued > self.bounds.queue_capacity or bool(frame.deferred.numpy()[0])
                attempt = 2
                passes += 1
        return passes


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
