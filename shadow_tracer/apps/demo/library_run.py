# SPDX-License-Identifier: Apache-2.0
"""Plays a sequence by the library alone, in this process: what the node would answer, without ROS."""

from __future__ import annotations

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from shadow_tracer import Bias, ShadowTracer
from shadow_tracer.apps.demo.collector import Shot, metres
from shadow_tracer.apps.demo.pace import Pace
from shadow_tracer.apps.demo.parameter_file import UNKNOWN_VALUE
from shadow_tracer.apps.demo.publisher import as_sent
from shadow_tracer.apps.demo.recording import COMPILING, Album, DemoError, Display, Recording
from shadow_tracer.apps.demo.sequence import Sequence, View


class LibraryRun:
    """Traces views with a :class:`ShadowTracer`.

    Args:
        sequence: what is played.
        pipeline: name, variant: "" for the first of the pipeline.
        device: auto, cpu or cuda:N.

    Raises:
        DemoError: there is no such device.
    """

    def __init__(self, sequence: Sequence, pipeline: str, variant: str, device: str) -> None:
        self._sequence = sequence
        self._lights = [light.light for light in sequence.lights]
        try:
            self._tracer = ShadowTracer(pipeline, variant or None, None if device == "auto" else device)
        except (ImportError, RuntimeError, ValueError) as error:
            raise DemoError(str(error)) from error
        self.device = {
            "device": self._tracer.device,
            "pipeline": self._tracer.pipeline,
            "variant": self._tracer.variant,
        }

    def shot(self, view: View) -> Shot:
        """Traces one view; the mesh stays that of the view before where it has none."""
        start = time.perf_counter()
        scene = self._tracer.scene
        if view.vertices is not None and "mesh" in scene:
            scene.deform("mesh", view.vertices)
        elif view.vertices is not None:
            scene.put("mesh", view.vertices, self._sequence.triangles)
        camera = as_sent(view.camera)
        frame = self._tracer.trace(view.depth, camera, self._lights, bias=Bias(*self._sequence.bias))
        masks = {light.name: frame.mask(light.name, unknown=UNKNOWN_VALUE) for light in self._lights}
        way = 1e3 * (time.perf_counter() - start)
        stages = {**frame.stages, "total": way}
        counters = {name: float(count) for name, count in frame.counters.items()}
        return Shot(time.time_ns(), camera, metres(view.depth), view.colour, masks, stages, counters, way)

    def play(self, console: Console, budget: float, height: int) -> Recording:
        """Plays the whole sequence, with a progress display.

        Args:
            budget: seconds for the frames of the animation; 0 leaves out none.
            height: of the frames of the animation, in pixels.
        """
        album, pace = Album(self._sequence, height), Pace(self._sequence.animated, budget)
        index = skipped = 0
        with Progress(SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                      TimeElapsedColumn(), console=console) as progress:  # fmt: skip
            display = Display(progress, self._sequence, f"library: {COMPILING}")
            took = self._tracer.warm_up()
            text = f"library: tracing on {self.device['device']}, ready after {took:.1f} s"
            while index < len(self._sequence):
                shot = self.shot(self._sequence.view(index))
                album.keep(index, shot, shot.stages)
                pace.answered(time.monotonic())
                due = pace.after(index)
                skipped, index = skipped + due - index - 1, due
                display.show(text, album.seen, album.seen, album.studio.done, skipped)
            while album.studio.working:
                time.sleep(0.05)
                display.show(text, album.seen, album.seen, album.studio.done, skipped)
        return album.recording(self.device, skipped)
