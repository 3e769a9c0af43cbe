# SPDX-License-Identifier: Apache-2.0
"""One step of work: the newest frame that has everything it needs, traced; or the reason why its mask says unknown."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import CameraInfo

from shadow_tracer import BoundsError, Camera, ShadowTracer
from shadow_tracer.ros.diagnostics import DEPTH, ERROR, PROCESSING, Missing
from shadow_tracer.ros.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.frames import Frames
from shadow_tracer.ros.mesh_input import MeshInput
from shadow_tracer.ros.messages import MessageError, intrinsics
from shadow_tracer.ros.settings import FloatArray, Light, Settings

_SHORTEST_WAIT = 0.1  # camera_info is a sibling of the image and may come after it, however short tf_timeout is

Mask = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Answer:
    """What is published for one depth image.

    Attributes:
        frame: the depth image.
        info: its camera_info, None if there is none.
        missing: why nothing is known; None if the frame was traced.
        mask: (H, W) uint8, all lights together.
        light_masks: the same per enabled light.
        stages: stage -> milliseconds, in order.
        numbers: counters of the tracer.
        warning: what is doubtful about the input though it was used, "" if nothing.
    """

    frame: WaitingFrame
    info: CameraInfo | None
    missing: Missing | None
    mask: Mask
    light_masks: dict[str, Mask]
    stages: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, Any] = field(default_factory=dict)
    warning: str = ""


class StopWatch:
    """Milliseconds between calls, by name, in order."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Note the time since the last call under ``name``."""
        now = time.perf_counter()
        self.stages[name] = (now - self._last) * 1e3
        self._last = now


@dataclass(frozen=True)
class _Job:
    info: CameraInfo
    camera: Camera
    lights: list[Light]
    mesh_to_world: FloatArray
    warning: str


class Processor:
    """Chooses frames and answers them."""

    def __init__(self, queue: FrameQueue, frames: Frames, mesh: MeshInput) -> None:
        self._queue = queue
        self._frames = frames
        self._mesh = mesh

    def step(self, settings: Settings, tracer: ShadowTracer, now: float, now_ns: int) -> Answer | None:
        """Answer the newest frame that is complete or has waited long enough; older ones are dropped.

        Args:
            now: steady time [s], on which frames wait.
            now_ns: time of the node's clock [ns], on which the mesh ages.

        Returns:
            None if every frame still waits, or there is none.
        """
        for frame in self._queue.newest_first():
            watch = StopWatch()
            watch.stages.update({"decode": frame.decoding, "wait": (now - frame.arrived) * 1e3})
            last_chance = now - frame.arrived >= max(settings.tf_timeout, _SHORTEST_WAIT)
            try:
                job = self._prepare(settings, frame, now_ns, last_chance)
                watch.lap("transforms")
                self._queue.take(frame)
                return self._trace(settings, tracer, frame, job, watch, now)
            except Missing as missing:
                if missing.wait and not last_chance:
                    continue
                self._queue.take(frame)
                return self._unknown(settings, frame, missing, watch)
        return None

    def _prepare(self, settings: Settings, frame: WaitingFrame, now_ns: int, last_chance: bool) -> _Job:
        if not settings.enabled_lights:
            raise Missing(
                PROCESSING, "no light is enabled; name one in the parameter lights and set lights.<name>.enabled", False
            )
        self._mesh.check_age(settings.mesh_max_age, now_ns)
        info = self._queue.info_for(frame, settings.camera_info_policy)
        height, width = frame.depth.shape
        try:
            optics = intrinsics(info, width, height)
        except MessageError as error:
            raise Missing(DEPTH, str(error), wait=False, level=ERROR) from error
        poses = self._frames.at(settings, frame.image.header.frame_id, frame.stamp, last_chance)
        lights = [
            light.light(poses.frame_to_world(light.frame, f"lights.{light.name}.frame"))
            for light in settings.enabled_lights
        ]
        mesh = poses.frame_to_world(settings.mesh_frame, "mesh.frame") if self._mesh.present else np.eye(4)
        return _Job(info, optics.camera(poses.camera_to_world), lights, mesh, optics.warning)

    def _trace(
        self, settings: Settings, tracer: ShadowTracer, frame: WaitingFrame, job: _Job, watch: StopWatch, now: float
    ) -> Answer:
        try:
            self._mesh.update(tracer.scene, job.mesh_to_world, now)
            watch.lap("mesh")
            tracer.front_face_culling = settings.front_face_culling
            traced = tracer.trace(frame.depth, job.camera, job.lights, bias=settings.bias)
            watch.lap("trace")
            mask = traced.mask(unknown=settings.unknown_value)
            light_masks = {light.name: traced.mask(light.name, unknown=settings.unknown_value) for light in job.lights}
            watch.lap("masks")
        except BoundsError as error:
            text = f"{error}; start the node with a larger value of that parameter"
            raise Missing(PROCESSING, text, wait=False, level=ERROR) from error
        except Exception as error:  # a driver may raise anything: the frame is unknown, the node lives
            text = f"the frame could not be traced: {error}; if it stays so, set another pipeline, or restart the node"
            raise Missing(PROCESSING, text, wait=False, level=ERROR) from error
        stages = watch.stages | {f"trace.{name}": value for name, value in traced.stages.items()}
        return Answer(frame, job.info, None, mask, light_masks, stages, dict(traced.counters), job.warning)

    def _unknown(self, settings: Settings, frame: WaitingFrame, missing: Missing, watch: StopWatch) -> Answer:
        mask = np.full(frame.depth.shape, settings.unknown_value, np.uint8)
        try:
            info = self._queue.info_for(frame, settings.camera_info_policy)
        except Missing:
            info = None
        watch.lap("transforms")
        masks = {light.name: mask for light in settings.enabled_lights}
        return Answer(frame, info, missing, mask, masks, watch.stages)
