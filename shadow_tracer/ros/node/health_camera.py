# SPDX-License-Identifier: Apache-2.0
"""What became of the images of one camera, for ``/diagnostics``. No ROS here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from shadow_tracer.ros.diagnostics import Complaint, Missing, Window
from shadow_tracer.ros.node.answer import Answer

if TYPE_CHECKING:
    from shadow_tracer.ros.node.camera_input import CameraInput


@dataclass
class CameraHealth:
    """Collects the outcomes of the images of a camera.

    Attributes:
        input: what is heard of it.
        traced, unknown: images of which everything, and nothing, is known.
        overflow_passes: as ``~/timing`` counts them.
        overflow: the last of them.
        missing: why nothing is known of the last image, None if all is.
        warning: what is doubtful about it, "" if nothing is.
        model: distortion model that its rays came from, "" if they were those of a pinhole.
        busy: time the node works on an image [ms]; ``total``: with the time it waits; ``latency``: its age in the end.
    """

    input: CameraInput
    traced: int = 0
    unknown: int = 0
    overflow_passes: int = 0
    overflow: Complaint = field(default_factory=Complaint)
    missing: Missing | None = None
    warning: str = ""
    model: str = ""
    busy: Window = field(default_factory=Window)
    total: Window = field(default_factory=Window)
    latency: Window = field(default_factory=Window)
    _known: float = float("-inf")
    _dropped: int = 0

    def note(self, answer: Answer, total: float, latency: float | None, now: float) -> None:
        """Take over the outcome of a frame.

        Args:
            total: its time in the node [ms].
            latency: its age at publication [ms]; None if there is no time.
            now: steady time [s].
        """
        self.missing = answer.missing
        self.warning = answer.warning
        self.model = answer.optics.model if answer.optics else ""
        if answer.missing is not None:
            self.unknown += 1
            return
        self.traced += 1
        self._known = now
        passes = int(answer.numbers.get("overflow_passes", 0))
        if passes:
            self.overflow_passes += passes
            self.overflow.add(f"{passes} further passes", now)
        self.busy.add(total - answer.stages.get("wait", 0.0))
        self.total.add(total)
        if latency is not None:
            self.latency.add(latency)

    def known(self, now: float, within: float) -> bool:
        """Whether everything is known of its last image, which was answered within so many seconds."""
        return self.missing is None and now - self._known <= within

    def newly_dropped(self) -> int:
        """Images dropped since this was last asked."""
        dropped = self.input.queue.dropped
        newly, self._dropped = dropped - self._dropped, dropped
        return newly

    def values(self) -> dict[str, Any]:
        """What ``input depth`` of a camera with a name says beside what every camera's says."""
        return {
            "traced": self.traced,
            "unknown": self.unknown,
            "dropped": self.input.queue.dropped,
            "left out by rate": self.input.limit.left_out,
            "waiting": len(self.input.queue),
            "frame in node, mean / 95 % / max [ms]": self.total.summary(),
            "age at publication, mean / 95 % / max [ms]": self.latency.summary(),
        }
