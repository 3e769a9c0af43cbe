# SPDX-License-Identifier: Apache-2.0
"""Plays a sequence, through the node or by the library alone, and keeps what the pictures need."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from typing import Any

from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from shadow_tracer.apps.demo.collector import Collector, Shot
from shadow_tracer.apps.demo.processes import Processes
from shadow_tracer.apps.demo.sequence import Sequence
from shadow_tracer.apps.demo.stage_times import WAY
from shadow_tracer.apps.demo.studio import PANEL_HEIGHT, Studio

LINGER = 5.0
COMPILING = "compiling kernels (first start only)"


class DemoError(RuntimeError):
    """The demo cannot go on; the message says why."""


@dataclass
class Recording:
    """What a run left.

    Attributes:
        still: the shot for the single pictures.
        panels: frames of the animation by index.
        times: per animated frame, stage -> milliseconds.
        device: what traced: device, pipeline, variant.
        seconds: how long the frames took, from the first mask to the last.
        skipped: frames left out because time ran short.
        lost: frames that were not answered in time or could not be traced.
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


class Album:
    """Keeps of each shot what the pictures and the table need.

    Args:
        sequence: what is played.
        height: of the frames of the animation, in pixels.

    Attributes:
        seen: how many shots have been kept.
        studio: shades the animation.
    """

    def __init__(self, sequence: Sequence, height: int = PANEL_HEIGHT) -> None:
        self.seen = 0
        self.studio = Studio(sequence, height)
        self._sequence = sequence
        self._still: tuple[int, Shot] | None = None
        self._times: list[dict[str, float]] = []
        self._first = self._last = 0.0
        self._size = (0, 0)

    def keep(self, index: int, shot: Shot, times: dict[str, float]) -> None:
        """Takes the shot of view `index`, whose stages took so many milliseconds."""
        self.seen += 1
        wanted = self._sequence.still
        if self._still is None or abs(index - wanted) < abs(self._still[0] - wanted):
            self._still = (index, shot)
        if index < self._sequence.animated:
            self._times.append(times)
            self._size = (shot.camera.width, shot.camera.height)
            self._last = time.monotonic()
            self._first = self._first or self._last
            self.studio.add(index, shot)

    def recording(self, device: dict[str, str], skipped: int, lost: int = 0, reason: str = "") -> Recording:
        """All of it, once the last shot is shaded.

        Raises:
            DemoError: if there is no shot; ``reason`` says why.
        """
        panels = self.studio.finish()
        if self._still is None:
            raise DemoError("no frame came back whole: " + (reason or "masks arrived too late"))
        seconds = self._last - self._first
        return Recording(self._still[1], panels, self._times, device, seconds, skipped, lost, reason, self._size)


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
        self._album = Album(sequence, height)

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
            device = collector.health.get("device", (0, "", {}))[2]
            heard = self._report
            return self._album.recording(
                device, heard.skipped, heard.lost + collector.unknown, collector.unknown_because
            )
        finally:
            executor.shutdown(timeout_sec=0.0)
            node.destroy_node()
            rclpy.try_shutdown()

    def _listen(self, executor: Any, collector: Collector, display: Display) -> None:
        end: float | None = None
        album, studio = self._album, self._album.studio
        while end is None or (album.seen + collector.unknown < len(self._report.sent) and time.monotonic() < end):
            executor.spin_once(timeout_sec=0.05)
            for shot in collector.take():
                self._keep(shot)
            self._show(display, collector)
            self._check()
            if end is None and self._processes.exit_code("publisher") is not None:
                end = time.monotonic() + LINGER
        while studio.working:
            self._show(display, collector)
            time.sleep(0.05)
        self._show(display, collector)

    def _show(self, display: Display, collector: Collector) -> None:
        masks, report = self._album.seen, self._report
        text = _state_of_the_node(collector.health, masks)
        display.show(text, max(report.rendered, masks), masks, self._album.studio.done, report.skipped)

    def _keep(self, shot: Shot) -> None:
        # the line with the index is written before the mask can be back, but another thread reads it
        for _ in range(100):
            if shot.stamp in self._report.sent:
                break
            time.sleep(0.01)
        self._album.keep(self._report.sent.get(shot.stamp, 0), shot, {**shot.stages, WAY: shot.way})

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


def _state_of_the_node(health: dict[str, tuple[int, str, dict[str, str]]], masks: int) -> str:
    """What the node is doing, by its latest diagnostics and the number of masks received."""
    if not masks:
        return f"node: {COMPILING}" if health else "node: starting"
    values = health.get("device", (0, "", {}))[2]
    ready = values.get("ready after [s]", "-")
    after = "" if ready == "-" else f", ready after {ready} s"
    return f"node: tracing on {values.get('device', '?')}{after}"


class Display:
    """The progress display: what the tracer is doing, and how far views, masks and pictures are."""

    def __init__(self, progress: Progress, sequence: Sequence, text: str = "node: starting") -> None:
        views = len(sequence)
        self._sequence = sequence
        self._progress = progress
        self._tracer = progress.add_task(text, total=None)
        self._views = progress.add_task("views made", total=views)
        self._masks = progress.add_task("masks", total=views)
        self._pictures = progress.add_task("pictures shaded", total=sequence.animated)

    def show(self, text: str, views: int, masks: int, pictures: int, skipped: int) -> None:
        """Brings the display up to date: what is going on, and how many of each there are."""
        self._progress.update(self._tracer, description=text)
        if masks:
            self._progress.update(self._tracer, total=1, completed=1)
        self._progress.update(self._views, completed=views)
        self._progress.update(self._masks, completed=masks, total=len(self._sequence) - skipped)
        self._progress.update(self._pictures, completed=pictures, total=self._sequence.animated - skipped)
