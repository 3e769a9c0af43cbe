# SPDX-License-Identifier: Apache-2.0
"""What ``/diagnostics`` says: five statuses, with several cameras one for the depth images of each. Every one has the
numbers behind it and, if something is wrong, what helps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from shadow_tracer.ros import diagnostics
from shadow_tracer.ros.diagnostics import (
    DEPTH,
    DEVICE,
    ERROR,
    MESH,
    OK,
    PROCESSING,
    TRANSFORMS,
    WARN,
    Complaint,
    Missing,
    Window,
)
from shadow_tracer.ros.node.answer import MOST_BITS
from shadow_tracer.ros.node.ground import Ground
from shadow_tracer.ros.node.health_camera import CameraHealth
from shadow_tracer.ros.node.health_inputs import Verdict, judge_depth, judge_mesh
from shadow_tracer.ros.node.inputs import Inputs
from shadow_tracer.ros.node.processing import Processor, named_in_vain
from shadow_tracer.ros.node.queries import MOST_LIGHTS, Queries
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.world.exposure import Exposure
from shadow_tracer.ros.world.frames import NO_TF, Frames

_BUSY_WORDS = {
    "start": "starting up for {:.0f} s: kernels are being loaded or, the first time, compiled",
    "select": "loading another pipeline for {:.0f} s: its kernels are compiled the first time",
    "verify": "loading the second pipeline of verify_every for {:.0f} s",
    "cones": "loading what answers about cones for {:.0f} s: its kernels are compiled the first time",
    "self-test": "self test for {:.0f} s: every pipeline traces a built-in scene, kernels are compiled the first time",
}

_NO_CLOCK = (
    "use_sim_time is true and no /clock comes: ages, lifetimes and tf have no time; start the simulator or "
    "`ros2 bag play --clock`, or set use_sim_time to false"
)

Doing = tuple[str, float] | None


@dataclass
class DeviceState:
    """What the node knows about its tracer."""

    name: str = "none"
    pipeline: str = ""
    variant: str = ""
    threads: int = 0
    ready_after: float = 0.0
    reserved: int = 0
    choice: str = ""
    error: str = ""


@dataclass
class Health:
    """Collects what happens, and judges it when asked.

    Attributes:
        node: name of the node, which the names of the statuses start with.
    """

    node: str
    inputs: Inputs
    frames: Frames
    processors: Mapping[str, Processor]
    queries: Queries
    exposure: Exposure
    ground: Ground
    device: DeviceState = field(default_factory=DeviceState)
    faults: Complaint = field(default_factory=Complaint)
    time_jumps: int = 0
    _lost_images: int = 0
    _lost: Complaint = field(default_factory=Complaint)

    def __post_init__(self) -> None:
        self.cameras = {name: CameraHealth(camera) for name, camera in self.inputs.cameras.items()}

    @property
    def traced(self) -> int:
        """Frames that were traced, of all cameras."""
        return sum(camera.traced for camera in self.cameras.values())

    def any_known(self, now: float, within: float) -> bool:
        """Whether everything is known of the last image of some camera, answered within so many seconds before the
        steady time ``now``."""
        return any(camera.known(now, within) for camera in self.cameras.values())

    def report(self, settings: Settings, doing: Doing, now: float, now_ns: int, stamp: Any) -> DiagnosticArray:
        """The message of ``/diagnostics``.

        Args:
            doing: name and seconds of what keeps the tracer from tracing; None if it is ready.
            now: steady time [s].
            now_ns: time of the node's clock [ns].
            stamp: the same as a message.
        """
        verdicts = {_depth(name): judge_depth(camera, now) for name, camera in self.cameras.items()}
        verdicts |= {
            MESH: judge_mesh(self.inputs, settings, now, now_ns),
            TRANSFORMS: self._judge_transforms(settings, now),
            DEVICE: self._judge_device(doing),
            PROCESSING: self._judge_processing(settings, doing, now, now_ns),
        }
        array = DiagnosticArray(status=[self._status(name, *verdict) for name, verdict in verdicts.items()])
        array.header.stamp = stamp
        return array

    def _status(self, name: str, level: bytes, text: str, values: dict[str, Any]) -> DiagnosticStatus:
        for camera, missing in self._all_missing():
            where = _depth(camera) if missing.status == DEPTH else missing.status
            if where == name and level <= missing.level:
                level, text = missing.level, missing.text if where != missing.status else _of(camera, missing.text)
                break
        return diagnostics.status(f"{self.node}: {name}", level, diagnostics.cure_first(text), values, self.node)

    def _all_missing(self) -> Iterator[tuple[str, Missing]]:
        """What is missing: of the images of cameras, each with its name, and of queries and the ground."""
        for name, camera in self.cameras.items():
            if camera.missing is not None:
                yield name, camera.missing
        for missing in (self.queries.missing, self.ground.missing):
            if missing is not None:
                yield "", missing

    def _judge_transforms(self, settings: Settings, now: float) -> Verdict:
        inputs = self.inputs
        topics, refused = [camera.topic("pose") for camera in inputs.cameras.values()], inputs.pose_refused
        values = {
            "pose_source": settings.pose_source,
            "fixed_frame": settings.fixed_frame or "-",
            "tf": "listening" if self.frames.has_tf else "not used",
            "camera_pose topic": ", ".join(topics),
            "camera poses kept": sum(map(len, self.frames.poses_of.values())),
            "lights placed by topics": ", ".join(inputs.lighting.moved()) or "-",
            "refused poses": refused.count,
            "last refusal": refused.text or "-",
        }
        if settings.pose_source == "tf" and settings.fixed_frame and not self.frames.has_tf and self.traced == 0:
            return ERROR, f"{NO_TF}no pose is known; set pose_source to topic or parameter", values
        lights = [name for name in inputs.subscriptions if name.startswith("light ")]
        mismatch = inputs.mismatch(*(camera.key("pose") for camera in inputs.cameras.values()), *lights)
        if mismatch:
            return ERROR, mismatch, values
        if refused.recent(now):
            return ERROR, f"pose refused, {refused.text}; correct the publisher of that topic", values
        if settings.pose_source == "tf" and not settings.fixed_frame:
            return OK, "fixed_frame is empty: the optical frame of the depth image is the world", values
        return OK, f"camera pose from {settings.pose_source}", values

    def _judge_device(self, doing: Doing) -> Verdict:
        device = self.device
        values = {
            "device": device.name,
            "pipeline": device.pipeline or "-",
            "variant": device.variant or "-",
            "threads": device.threads or "-",
            "ready after [s]": f"{device.ready_after:.2f}" if device.ready_after else "-",
            "choice": device.choice or "-",
            "reserved [MB]": f"{device.reserved / 1e6:.0f}",
        }
        if doing is not None:
            return OK, _BUSY_WORDS[doing[0]].format(doing[1]), values
        if device.error and not device.pipeline:
            text = f"the tracer cannot be made: {device.error}"
            if device.error.startswith("kernel cache: "):  # it says itself what helps
                return ERROR, text, values
            return ERROR, f"{text}; correct that parameter and start again", values
        if device.error:
            text = f"{device.error}; {device.pipeline} stays in use, set the parameters pipeline and variant again"
            return ERROR, text, values
        if not device.pipeline:
            return OK, "no tracer yet: configure the node", values
        return OK, f"{device.pipeline}/{device.variant} on {device.name}", values

    def _judge_processing(self, settings: Settings, doing: Doing, now: float, now_ns: int) -> Verdict:
        cameras, queries = self.cameras.values(), self.queries
        dropped = sum(camera.newly_dropped() for camera in cameras)
        if dropped and settings.process == "every":
            self._lost_images += dropped
            self._lost.add(f"{self._lost_images} images were dropped although process is every", now)
        differing = sum(processor.differing for processor in self.processors.values())
        values = {
            "traced": self.traced,
            "unknown": sum(camera.unknown for camera in cameras),
            "dropped": sum(camera.input.queue.dropped for camera in cameras),
            "waiting": self.inputs.waiting,
            "frame in node, mean / 95 % / max [ms]": Window.summary_of([camera.total for camera in cameras]),
            "age at publication, mean / 95 % / max [ms]": Window.summary_of([camera.latency for camera in cameras]),
            "overflow passes": sum(camera.overflow_passes for camera in cameras),
            "verified frames": sum(processor.verified for processor in self.processors.values()),
            "differing": differing,
            "queries answered": queries.answered,
            "queries of which nothing is known": queries.unknown,
            "queries refused": queries.refused.count,
            "queries dropped": queries.dropped,
            "last query refusal": queries.refused.text or "-",
            "shadow grids": self.ground.grids,
            "sun maps": self.ground.maps,
            "time jumps back": self.time_jumps,
            "faults": self.faults.count,
            "last fault": self.faults.text or "-",
        }
        if self.faults.recent(now):
            return ERROR, f"{self.faults.text}; the node goes on, please report this with its log", values
        if differing:
            text = f"{differing} pixels of verified frames differ between two pipelines; please report this"
            return ERROR, text, values
        if doing is not None:
            what = "starting up" if doing[0] == "start" else doing[0]
            return OK, f"{what}: frames wait until kernels are ready", values
        if not now_ns:
            return WARN, _NO_CLOCK, values
        for name, camera in self.cameras.items():
            if camera.missing is not None:
                where = _depth(name) if camera.missing.status == DEPTH else camera.missing.status
                text = f"the last mask says unknown, see {where!r}: {camera.missing.text}"
                return WARN, _of(name, text), values
        if queries.missing is not None:
            return WARN, f"the last query has no answer, see {queries.missing.status!r}: {queries.missing.text}", values
        lost = self.ground.missing
        if lost is not None:
            return WARN, f"the last shadow_grid says unknown, see {lost.status!r}: {lost.text}", values
        warning = self._doubts(settings, now)
        if warning:
            return WARN, warning, values
        if self.traced == 0:
            return OK, "ready, no frame yet", values
        return OK, f"{self.traced} frames traced", values

    def _doubts(self, settings: Settings, now: float) -> str:
        """What works, but not as it should; "" if everything does."""
        queries = self.queries
        if queries.refused.recent(now):
            return f"query refused, {queries.refused.text}; correct its publisher"
        if settings.front_face_culling and settings.uses_depth:
            return (
                "a depth image shows fronts only, and front_face_culling lets light through fronts; set one of "
                "front_face_culling and occluders back"
            )
        if settings.process == "every" and self._lost.recent(now):
            return (
                f"{self._lost.text}: they come faster than they can be answered; play the bag with a lower --rate, or "
                "use `shadow_tracer bag`"
            )
        overflow = next((camera.overflow for camera in self.cameras.values() if camera.overflow.recent(now)), None)
        if overflow is not None:
            return (
                f"{overflow.text} were needed, which costs time, no answer; start with a larger "
                "bounds.queue_capacity, or bounds.grid_entries for light_grid"
            )
        if self.exposure.trouble:
            return self.exposure.trouble
        vain = named_in_vain(settings, self.inputs.meshes.store.parts)
        if vain:
            return f"{vain}; correct the name, or publish the part"
        if len(settings.lights) > MOST_BITS and settings.mask_publish == "always":
            return f"light_bits has {MOST_BITS} bits and is not published for {len(settings.lights)} lights; name fewer"
        if len(settings.lights) > MOST_LIGHTS and queries.answered:
            return f"query/visibility has {MOST_LIGHTS} bits: it leaves out all later lights; name fewer"
        return ""


def _depth(camera: str) -> str:
    """Name of the status about the depth images of a camera."""
    return f"{DEPTH} {camera}" if camera else DEPTH


def _of(camera: str, text: str) -> str:
    """A text that says which camera it is about, if it has a name."""
    return f"camera {camera}: {text}" if camera else text
