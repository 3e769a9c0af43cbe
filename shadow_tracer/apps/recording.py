# SPDX-License-Identifier: Apache-2.0
"""Starts node and publisher, listens until the sequence has been played, and keeps what the pictures need."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from typing import Any

from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from shadow_tracer.apps.collector import Collector, Shot
from shadow_tracer.apps.processes import Processes
from shadow_tracer.apps.sequence import Sequence
from shadow_tracer.apps.stage_times import WAY
from shadow_tracer.apps.studio import PANEL_HEIGHT, Studio

LINGER = 5.0


class DemoError(RuntimeError):
    """The demo cannot go on; the message says why."""


@dataclass
class Recording:
    """What a run left.

    Attributes:
        still: the shot for the single pictures.
        panels: frames of the animation by index.
        times: per animated frame, stage -> milliseconds.
        device: what the node says about its device: device, pipeline, variant, time until ready.
        seconds: how long the frames took, from the first mask to the last.
        skipped: frames left out because time ran short.
        lost: frames that the node did not answer in time or could not trace.
        reason: why it could not trace, the last time; empty if it could.
        size: (width, height) of the animated frames.
    """

    still: Shot
    panels: dict[int, Image.Image]
    times: list[dict[str, float]]
    device: dict[str, str]
    seconds: float
    skipped: int
    lost: int
    reason: str
    size: tuple[int, int]


@dataclass
class Report:
    """What the publisher says about itself."""

    rendered: int = 0
    lost: int = 0
    skipped: int = 0
    error: str = ""
    sent: dict[int, int] = field(default_factory=dict)  # stamp in nanoseconds -> index of the view

    def hear(self, line: str) -> None:
        """Takes in one line of its output."""
        try:
            said = json.loads(line)
        except ValueError:
            return
        self.rendered = said.get("rendered", self.rendered)
        self.error = said.get("error", self.error)
        self.lost += "lost" in said
        self.skipped += said.get("skipped", 0)
        if "sent" in said:
            self.sent[said["stamp"]] = said["sent"]


class Recorder:
    """Listens to a running node and publisher.

    Args:
        sequence: what is played.
        processes: where "node" and "publisher" run.
        report: what the publisher has said so far.
        height: of the frames of the animation, in pixels.
    """

    def __init__(self, sequence: Sequence, processes: Processes, report: Report, height: int = PANEL_HEIGHT) -> None:
        self._sequence = sequence
        self._processes = processes
        self._report = report
        self._studio = Studio(sequence, height)
        self._still: tuple[int, Shot] | None = None
        self._times: list[dict[str, float]] = []
        self._seen = 0
        self._first = self._last = 0.0
        self._size = (0, 0)

    def run(self, console: Console) -> Recording:
        """Listens to the end, with a progress display.

        Raises:
            DemoError: if a process fails or no mask comes back.
        """
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        # Ctrl-C must reach this program, not only ROS
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node("demo_listener")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            collector = Collector(node, [light.name for light in self._sequence.lights])
            with Progress(SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                          TimeElapsedColumn(), console=console) as progress:  # fmt: skip
                self._listen(executor, collector, Display(progress, self._sequence))
            panels = self._studio.finish()
            if self._still is None:
                raise DemoError("no frame came back whole: " + (collector.unknown_because or "masks arrived too late"))
            device = collector.health.get("device", (0, "", {}))[2]
            seconds = self._last - self._first
            heard = self._report
            lost, reason = heard.lost + collector.unknown, collector.unknown_because
            still = self._still[1]
            return Recording(still, panels, self._times, device, seconds, heard.skipped, lost, reason, self._size)
        finally:
            executor.shutdown(timeout_sec=0.0)
            node.destroy_node()
            rclpy.try_shutdown()

    def _listen(self, executor: Any, collector: Collector, display: Display) -> None:
        end: float | None = None
        while end is None or (self._seen + collector.unknown < len(self._report.sent) and time.monotonic() < end):
            executor.spin_once(timeout_sec=0.05)
            for shot in collector.take():
                self._keep(shot)
            display.show(collector.health, self._report, self._seen, self._studio.done)
            self._check()
            if end is None and self._processes.exit_code("publisher") is not None:
                end = time.monotonic() + LINGER
        while self._studio.working:
            display.show(collector.health, self._report, self._seen, self._studio.done)
            time.sleep(0.05)
        display.show(collector.health, self._report, self._seen, self._studio.done)

    def _keep(self, shot: Shot) -> None:
        self._seen += 1
        # the line with the index is written before the mask can be back, but another thread reads it
        for _ in range(100):
            if shot.stamp in self._report.sent:
                break
            time.sleep(0.01)
        index = self._report.sent.get(shot.stamp, 0)
        wanted = self._sequence.still
        if self._still is None or abs(index - wanted) < abs(self._still[0] - wanted):
            self._still = (index, shot)
        if index < self._sequence.animated:
            self._times.append({**shot.stages, WAY: shot.way})
            self._size = (shot.camera.width, shot.camera.height)
            self._last = time.monotonic()
            self._first = self._first or self._last
            self._studio.add(index, shot)

    def _check(self) -> None:
        """Raises DemoError if a process has failed."""
        if (code := self._processes.exit_code("node")) is not None:
            raise DemoError(f"the node ended with exit code {code}:\n{self._processes.tail('node')}")
        if self._report.error:
            what = f"the publisher gave up: {self._report.error}"
            tail = self._processes.tail("node")
            raise DemoError(f"{what}\nThe node's last words:\n{tail}" if tail else what)
        if (code := self._processes.exit_code("publisher")) not in (None, 0):
            raise DemoError(f"the publisher ended with exit code {code}:\n{self._processes.tail('publisher')}")


class Display:
    """The progress display: what the node is doing, and how far views, masks and pictures are."""

    def __init__(self, progress: Progress, sequence: Sequence) -> None:
        views = len(sequence)
        self._sequence = sequence
        self._progress = progress
        self._node = progress.add_task("node: starting", total=None)
        self._views = progress.add_task("views made", total=views)
        self._masks = progress.add_task("masks received", total=views)
        self._pictures = progress.add_task("pictures shaded", total=sequence.animated)

    def show(
        self, health: dict[str, tuple[int, str, dict[str, str]]], report: Report, masks: int, pictures: int
    ) -> None:
        """Brings the display up to date."""
        values = health.get("device", (0, "", {}))[2]
        if masks:
            ready = values.get("ready after [s]", "-")
            after = "" if ready == "-" else f", ready after {ready} s"
            text = f"node: tracing on {values.get('device', '?')}{after}"
        elif health:
            text = "node: compiling kernels (first start only)"
        else:
            text = "node: starting"
        self._progress.update(self._node, description=text)
        if masks:
            self._progress.update(self._node, total=1, completed=1)
        self._progress.update(self._views, completed=max(report.rendered, masks))
        self._progress.update(self._masks, completed=masks, total=len(self._sequence) - report.skipped)
        self._progress.update(self._pictures, completed=pictures, total=self._sequence.animated - report.skipped)
