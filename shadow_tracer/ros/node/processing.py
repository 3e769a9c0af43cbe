# SPDX-License-Identifier: Apache-2.0
"""One step of work: the next frame that has everything it needs, traced; or the reason why nothing is known of it.

No ROS here: the offline tool works with the same code.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from shadow_tracer import BoundsError, Camera, Frame, Scene, ShadowTracer
from shadow_tracer.ros.cameras.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.diagnostics import DEPTH, ERROR, MESH, PROCESSING, Missing
from shadow_tracer.ros.node.answer import Answer
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.messages import Intrinsics, MessageError, intrinsics, is_raw
from shadow_tracer.ros.wire.parts import Part
from shadow_tracer.ros.world.frames import Frames, Poses
from shadow_tracer.ros.world.lighting import Lighting, Lit
from shadow_tracer.ros.world.mesh_store import MeshStore, is_named
from shadow_tracer.scene.depth_mesh import depth_mesh

if TYPE_CHECKING:
    from sensor_msgs.msg import CameraInfo

_SHORTEST_WAIT = 0.1  # camera_info is a sibling of the image and may come after it, however short tf_timeout is
DEPTH_PART = "depth"  # name in the scene of the surface that the depth image shows; no received part is called so


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
    optics: Intrinsics
    camera: Camera
    lit: Lit
    poses: Poses


class Processor:
    """Chooses frames and answers them.

    Attributes:
        verified: frames that were traced by a second pipeline too.
        differing: pixels and lights of them on which the two did not agree.
    """

    def __init__(self, queue: FrameQueue, frames: Frames, meshes: MeshStore, lighting: Lighting) -> None:
        self.verified = self.differing = 0
        self._queue = queue
        self._frames = frames
        self._meshes = meshes
        self._lighting = lighting
        self._traced = 0

    def skip(self, count: int) -> None:
        """So many images were traced elsewhere: ``verify_every`` counts them too."""
        self._traced += count

    def step(
        self, settings: Settings, tracer: ShadowTracer, now: float, now_ns: int, patient: bool = True
    ) -> Answer | None:
        """Answer the next frame that is complete or has waited long enough.

        Args:
            now: steady time [s], on which frames wait.
            now_ns: time of the node's clock [ns], on which meshes age.
            patient: False: nothing that is missing now will come, no frame waits.

        Returns:
            None if every frame still waits, or there is none.
        """
        for frame in self._queue.candidates():
            watch = StopWatch()
            watch.stages.update({"decode": frame.decoding, "wait": (now - frame.arrived) * 1e3})
            last_chance = not patient or now - frame.arrived >= max(settings.tf_timeout, _SHORTEST_WAIT)
            try:
                job = self._prepare(settings, frame, now_ns, last_chance)
                watch.lap("transforms")
                self._follow(settings, tracer.scene, job.poses, frame.parts)
                watch.lap("mesh")
                self._queue.take(frame)
                return self._trace(settings, tracer, frame, job, watch)
            except Missing as missing:
                if missing.wait and not last_chance:
                    continue
                self._queue.take(frame)
                return self._unknown(settings, frame, missing, watch)
            except BoundsError as error:
                text = f"{error}; start the node with a larger value of that parameter"
                fault = Missing(PROCESSING, text, wait=False, level=ERROR)
            except Exception as error:  # a driver may raise anything: the frame is unknown, the node lives
                text = f"the frame could not be traced: {error}; if it stays so, set another pipeline, or restart it"
                fault = Missing(PROCESSING, text, wait=False, level=ERROR)
            self._queue.take(frame)
            return self._unknown(settings, frame, fault, watch)
        return None

    def _prepare(self, settings: Settings, frame: WaitingFrame, now_ns: int, last_chance: bool) -> _Job:
        check_meshes(self._meshes, settings, now_ns)
        info = self._queue.info_for(frame, settings.camera_info_policy, last_chance)
        height, width = frame.depth.shape
        # An image beyond the bounds is refused by the tracer: no table of rays is made for it.
        raw = is_raw(info, frame.topic, settings.distortion) and frame.depth.size <= settings.max_rays
        try:
            optics = intrinsics(info, width, height, raw)
        except MessageError as error:
            cure = "" if "; " in str(error) else "; correct the driver of the camera"
            raise Missing(DEPTH, f"{error}{cure}", wait=False, level=ERROR) from error
        camera_frame = settings.camera_frame or frame.image.header.frame_id
        poses = self._frames.at(settings, camera_frame, frame.stamp, last_chance)
        lit = self._lighting.at(settings, poses, frame.stamp)
        return _Job(info, optics, optics.camera(poses.camera_to_world), lit, poses)

    def _follow(self, settings: Settings, scene: Scene, poses: Poses, parts: Mapping[str, Part] | None) -> None:
        forget_surface(scene, settings)
        how = scene, poses, settings.mesh_frame, settings.uses_meshes, parts, settings.mesh_cast_no_shadows
        try:
            self._meshes.update(*how)
        except BoundsError:
            if DEPTH_PART not in scene:
                raise
            scene.remove(DEPTH_PART)  # that of the image before, which is replaced anyway, may be in the way
            self._meshes.update(*how)

    def _trace(
        self, settings: Settings, tracer: ShadowTracer, frame: WaitingFrame, job: _Job, watch: StopWatch
    ) -> Answer:
        scene = tracer.scene
        if settings.uses_depth:
            _put_depth(settings, scene, frame, job.camera)
            watch.lap("depth_occluder")
        traced: Frame | None = None
        numbers: dict[str, Any] = {}
        if job.lit.lights:
            tracer.front_face_culling = settings.front_face_culling
            traced = tracer.trace(frame.depth, job.camera, job.lit.lights, settings.bias, settings.samples)
            watch.lap("trace")
            watch.stages |= {f"trace.{name}": value for name, value in traced.stages.items()}
            numbers |= traced.counters | self._verify(settings, tracer, frame, job, watch)
        return Answer(
            frame,
            job.info,
            None,
            *_names(settings),
            settings.unknown_value,
            traced,
            job.optics,
            watch.stages,
            numbers,
            job.optics.warning,
            settings.uses_depth,
        )

    def _verify(
        self, settings: Settings, tracer: ShadowTracer, frame: WaitingFrame, job: _Job, watch: StopWatch
    ) -> dict[str, int]:
        self._traced += 1
        if not settings.verify_every or self._traced % settings.verify_every:
            return {}
        differing = tracer.verify(frame.depth, job.camera, job.lit.lights, settings.bias, samples=settings.samples)
        watch.lap("verify")
        self.verified += 1
        self.differing += differing
        return {"verify.differing": differing}

    def _unknown(self, settings: Settings, frame: WaitingFrame, missing: Missing, watch: StopWatch) -> Answer:
        try:
            info = self._queue.info_for(frame, settings.camera_info_policy)
        except Missing:
            info = None
        watch.lap("transforms")
        return Answer(
            frame,
            info,
            missing,
            *_names(settings),
            settings.unknown_value,
            stages=watch.stages,
        )


def _names(settings: Settings) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Names of all lights, of those enabled, and of these with a strength."""
    enabled = settings.enabled_lights
    return (
        tuple(light.name for light in settings.lights),
        tuple(light.name for light in enabled),
        tuple(light.name for light in enabled if light.strength is not None),
    )


def _put_depth(settings: Settings, scene: Scene, frame: WaitingFrame, camera: Camera) -> None:
    """Let the depth image cast shadow: its triangles are made on the device, which has room for two in each cell; where
    there is no such room, those that there are are made here."""
    how = settings.depth_occluder_step, settings.depth_occluder_max_jump
    try:
        scene.put_depth(DEPTH_PART, frame.depth, camera, *how)
    except BoundsError:
        scene.put(DEPTH_PART, *depth_mesh(frame.depth, camera, *how), camera.camera_to_world)


def forget_surface(scene: Scene, settings: Settings) -> None:
    """Take the surface of an earlier depth image out of the scene if it is not to cast shadow any more."""
    if not settings.uses_depth and DEPTH_PART in scene:
        scene.remove(DEPTH_PART)


def named_in_vain(settings: Settings, parts: Iterable[str]) -> str:
    """Which part that there is not is to cast no shadow, in all lights or in one, and the parts there are; "" if there
    is none."""
    known = [*parts]
    wishes = [("mesh.cast_no_shadows", settings.mesh_cast_no_shadows, known)]
    wishes += [(f"lights.{each.name}.ignore", each.ignore, [*known, DEPTH_PART]) for each in settings.enabled_lights]
    for parameter, names, there in wishes:
        for name in names:
            if not any(is_named(key, [name]) for key in there):
                some = ", ".join(there[:8]) + (", ..." if len(there) > 8 else "")
                return f"{parameter} names {name!r}, but the parts are {some or 'none'}"
    return ""


def check_meshes(meshes: MeshStore, settings: Settings, now_ns: int) -> None:
    """Drop the parts whose lifetime is over, and raise Missing if one that is left is stale, or if a mesh was refused
    before there was a good one.

    Args:
        now_ns: time of the node's clock [ns].
    """
    meshes.expire(now_ns)
    if not settings.uses_meshes:
        return
    if meshes.lacking and not meshes.parts:
        text = (
            f"what casts shadow is not known: a mesh was refused and there is no earlier one, {meshes.lacking}; "
            "correct its publisher, or mesh.files"
        )
        raise Missing(MESH, text, wait=False, level=ERROR)
    if settings.mesh_max_age <= 0.0:
        return
    key, age = meshes.oldest(now_ns)
    if age > settings.mesh_max_age:
        what = "the mesh" if key == "mesh" else f"mesh part {key!r}"
        raise Missing(
            MESH,
            f"{what} is {age:.1f} s old and mesh.max_age is {settings.mesh_max_age:g} s; restart its publisher, or set "
            "mesh.max_age to 0",
            wait=False,
        )
