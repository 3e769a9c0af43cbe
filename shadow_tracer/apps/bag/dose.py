# SPDX-License-Identifier: Apache-2.0
"""What parts of a recording's world receive: ``~/dose/*`` as the node sends them, by the time of the log."""

from __future__ import annotations

from typing import Any

from shadow_tracer import ShadowTracer
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.writer import Output
from shadow_tracer.ros.node.answer import Answer
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.cdr_markers import encode_markers
from shadow_tracer.ros.wire.dose_messages import DoseMarkers, cloud_rows
from shadow_tracer.ros.world.exposure import Exposure, folder_of
from shadow_tracer.ros.world.scene_markers import world_name

TOPICS = ("~/dose/cloud", "~/dose/markers", "~/dose/coverage", "~/dose/done")


class BagDose:
    """Sums up and writes, where ``dose.parts`` names parts.

    Raises:
        ValueError: there is no such folder as ``dose.folder``.

    Attributes:
        troubles: what was doubtful, each once, in order.
    """

    def __init__(self, settings: Settings, tracer: ShadowTracer, output: Output, names: Names) -> None:
        self.troubles: dict[str, None] = {}
        if settings.dose_parts and settings.dose_folder:
            folder_of(settings)  # not after an hour of work
        self._settings = settings
        self._tracer = tracer
        self._output = output
        self._topics = [names.topic(topic) for topic in TOPICS]
        self._exposure = Exposure()
        self._drawn = DoseMarkers()

    def note(self, answer: Answer, now_ns: int, camera_frame: str) -> None:
        """An image was answered at a time of the log [ns]."""
        if answer.missing is not None:
            self._exposure.pause()
            return
        lights = answer.traced.lights if answer.traced is not None else ()
        if self._exposure.note(self._settings, self._tracer, lights, now_ns):
            self._write(answer.frame.image.header, now_ns, world_name(self._settings, camera_frame))
        if self._exposure.trouble:
            self.troubles[self._exposure.trouble] = None

    def finish(self) -> None:
        """Write the maps to ``dose.folder`` if there is one.

        Raises:
            ValueError, OSError: they cannot be written.
        """
        if self._settings.dose_folder and self._exposure.maps:
            self._exposure.save(self._settings)

    def _write(self, header: Any, now_ns: int, world: str) -> None:
        target, shown = self._settings.dose_target, self._exposure.shown()
        cloud, markers, coverage, done = self._topics
        if world:
            self._output.cloud(cloud, now_ns, cloud_rows(shown, target), header.stamp, world)
            message = self._drawn.message(shown, target, world)
            if message:
                self._output.raw(markers, now_ns, "visualization_msgs/msg/MarkerArray", encode_markers(message))
        self._output.value(coverage, now_ns, "std_msgs/msg/Float32", self._exposure.coverage(target))
        self._output.value(done, now_ns, "std_msgs/msg/Bool", self._exposure.done(self._settings))
