# SPDX-License-Identifier: Apache-2.0
"""What ``/diagnostics`` says: five statuses, each with the numbers behind it and, if something is wrong, what helps."""

from __future__ import annotations

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
    RateMeter,
    Window,
)
from shadow_tracer.ros.frame_queue import FrameQueue
from shadow_tracer.ros.frames import NO_TF, Frames
from shadow_tracer.ros.mesh_input import MeshInput
from shadow_tracer.ros.processing import Answer
from shadow_tracer.ros.settings import Settings

_SILENT = 3.0  # seconds after which an input counts as silent

Verdict = tuple[bytes, str, dict[str, Any]]


@dataclass
class DeviceState:
    """What the node knows about its tracer."""

    name: str = "none"
    pipeline: str = ""
    variant: str = ""
    ready_after: float = 0.0
    error: str = ""


@dataclass
class Health:
    """Collects what happens, and judges it when asked.

    Attributes:
        node: name of the node, which the names of the statuses start with.
        topics: resolved names of the inputs: "depth", "info", "mesh", "pose".
    """

    node: str
    topics: dict[str, str]
    queue: FrameQueue
    frames: Frames
    mesh: MeshInput
    device: DeviceState = field(default_factory=DeviceState)
    depth: RateMeter = field(default_factory=RateMeter)
    depth_refused: Complaint = field(default_factory=Complaint)
    pose_refused: Complaint = field(default_factory=Complaint)
    faults: Complaint = field(default_factory=Complaint)
    depth_format: str = "-"
    skipped: int = 0
    traced: int = 0
    unknown: int = 0
    overflow_passes: int = 0
    time_jumps: int = 0
    mesh_mismatch: str = ""
    depth_mismatch: str = ""
    _missing: Missing | None = None
    _warning: str = ""
    _total: Window = field(default_factory=Window)
    _latency: Window = field(default_factory=Window)

    def note(self, answer: Answer, total: float, latency: float) -> None:
        """Take over the outcome of a frame, its time in the node and its age at publication [ms]."""
        self._missing = answer.missing
        self._warning = answer.warning
        if answer.missing is None:
            self.traced += 1
            self.overflow_passes += int(answer.numbers.get("overflow_passes", 0))
            self._total.add(total)
            self._latency.add(latency)
        else:
            self.unknown += 1

    def report(
        self, settings: Settings, busy_for: float | None, now: float, now_ns: int, stamp: Any
    ) -> DiagnosticArray:
        """The message of ``/diagnostics``.

        Args:
            busy_for: seconds the tracer has been starting up; None if it is ready.
            now: steady time [s].
            now_ns: time of the node's clock [ns].
            stamp: the same as a message.
        """
        verdicts = {
            DEPTH: self._judge_depth(now),
            MESH: self._judge_mesh(settings, now, now_ns),
            TRANSFORMS: self._judge_transforms(settings, now),
            DEVICE: self._judge_device(busy_for),
            PROCESSING: self._judge_processing(busy_for, now),
        }
        array = DiagnosticArray(status=[self._status(name, *verdict) for name, verdict in verdicts.items()])
        array.header.stamp = stamp
        return array

    def _status(self, name: str, level: bytes, text: str, values: dict[str, Any]) -> DiagnosticStatus:
        if self._missing is not None and self._missing.status == name and level <= self._missing.level:
            level, text = self._missing.level, self._missing.text
        return diagnostics.status(f"{self.node}: {name}", level, text, values, self.node)

    def _judge_depth(self, now: float) -> Verdict:
        rate = self.depth.rate(now)
        values = {
            "topic": self.topics["depth"],
            "camera_info topic": self.topics["info"],
            "rate [Hz]": f"{rate:.1f}",
            "age [s]": f"{self.depth.age(now):.2f}",
            "format": self.depth_format,
            "received": self.depth.count,
            "refused": self.depth_refused.count,
            "last refusal": self.depth_refused.text or "-",
            "skipped before the node": self.skipped,
        }
        if self.depth_mismatch:
            return ERROR, self.depth_mismatch, values
        if self.depth_refused.recent(now):
            text = f"image refused, {self.depth_refused.text}; correct the publisher of {self.topics['depth']}"
            return ERROR, text, values
        if self.depth.age(now) > _SILENT:
            topic = self.topics["depth"]
            hint = f"see `ros2 topic hz {topic}`, or remap depth/image_rect to the topic of the camera"
            if self.depth.count == 0:
                return WARN, f"no depth image on {topic}; {hint}", values
            return WARN, f"no depth image for {self.depth.age(now):.0f} s on {topic}; {hint}", values
        if self._warning:
            return WARN, self._warning, values
        return OK, f"{self.depth_format} at {rate:.1f} Hz", values

    def _judge_mesh(self, settings: Settings, now: float, now_ns: int) -> Verdict:
        mesh = self.mesh
        values = {
            "topic": self.topics["mesh"],
            "frame": settings.mesh_frame or settings.fixed_frame or "-",
            "rate [Hz]": f"{mesh.arrivals.rate(now):.1f}",
            "age [s]": f"{mesh.age(now_ns):.2f}" if mesh.present else "-",
            "triangles": mesh.triangle_count,
            "vertices": mesh.vertex_count,
            "received": mesh.arrivals.count,
            "refused": mesh.refused.count,
            "last refusal": mesh.refused.text or "-",
            "replaced": mesh.updates["put"],
            "deformed": mesh.updates["deform"],
            "parsing, mean / 95 % / max [ms]": mesh.parsing.summary(),
        }
        topic = self.topics["mesh"]
        if self.mesh_mismatch:
            return ERROR, self.mesh_mismatch, values
        if mesh.refused.recent(now):
            return (
                ERROR,
                f"mesh refused, {mesh.refused.text}; the last good one stays; correct the publisher of {topic}",
                values,
            )
        if not mesh.present:
            text = f"no mesh: every valid pixel is lit; publish shape_msgs/Mesh on {topic}, or remap mesh to its topic"
            return WARN, text, values
        if mesh.triangle_count == 0:
            return WARN, f"the mesh has no triangles: every valid pixel is lit; see the publisher of {topic}", values
        return OK, f"{mesh.triangle_count} triangles", values

    def _judge_transforms(self, settings: Settings, now: float) -> Verdict:
        values = {
            "pose_source": settings.pose_source,
            "fixed_frame": settings.fixed_frame or "-",
            "tf": "listening" if self.frames.has_tf else "not used",
            "camera_pose topic": self.topics["pose"],
            "camera poses kept": len(self.frames.camera_poses),
            "refused camera poses": self.pose_refused.count,
            "last refusal": self.pose_refused.text or "-",
        }
        if settings.pose_source == "tf" and settings.fixed_frame and not self.frames.has_tf and self.traced == 0:
            return ERROR, f"{NO_TF}set pose_source to topic or parameter", values
        if self.pose_refused.recent(now):
            return (
                ERROR,
                f"camera_pose refused, {self.pose_refused.text}; correct the publisher of {self.topics['pose']}",
                values,
            )
        if settings.pose_source == "tf" and not settings.fixed_frame:
            return OK, "fixed_frame is empty: the optical frame of the depth image is the world", values
        return OK, f"camera pose from {settings.pose_source}", values

    def _judge_device(self, busy_for: float | None) -> Verdict:
        device = self.device
        values = {
            "device": device.name,
            "pipeline": device.pipeline or "-",
            "variant": device.variant or "-",
            "ready after [s]": f"{device.ready_after:.2f}" if device.ready_after else "-",
        }
        if busy_for is not None:
            return (
                OK,
                f"starting up for {busy_for:.0f} s: kernels are being loaded or, the first time, compiled",
                values,
            )
        if device.error:
            text = f"{device.error}; {device.pipeline} stays in use, set the parameters pipeline and variant again"
            return ERROR, text, values
        return OK, f"{device.pipeline}/{device.variant} on {device.name}", values

    def _judge_processing(self, busy_for: float | None, now: float) -> Verdict:
        values = {
            "traced": self.traced,
            "unknown": self.unknown,
            "dropped": self.queue.dropped,
            "waiting": len(self.queue),
            "frame in node, mean / 95 % / max [ms]": self._total.summary(),
            "age at publication, mean / 95 % / max [ms]": self._latency.summary(),
            "overflow passes": self.overflow_passes,
            "time jumps back": self.time_jumps,
            "faults": self.faults.count,
            "last fault": self.faults.text or "-",
        }
        if self.faults.recent(now):
            return ERROR, f"{self.faults.text}; the node goes on, please report this with its log", values
        if busy_for is not None:
            return OK, "starting up: frames wait until kernels are ready", values
        if self._missing is not None:
            return WARN, f"the last mask says unknown, see {self._missing.status!r}: {self._missing.text}", values
        if self.traced == 0:
            return OK, "ready, no frame yet", values
        return OK, f"{self.traced} frames traced", values
