# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer demo`: a moving scene lit by three lights, and pictures of the masks; with --uv a robot with a UV-C
tube, and the dose of a hospital room.

The library traces in this process, or, with --node, the real node does: it and the publisher run as separate processes
and talk over ROS topics, and this process only listens. The masks have the same bits.
"""

from __future__ import annotations

import argparse
import importlib.util
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

from shadow_tracer import available_pipelines
from shadow_tracer.apps.demo import publisher, stage_times
from shadow_tracer.apps.demo.parameter_file import parameters, yaml
from shadow_tracer.apps.demo.processes import Processes
from shadow_tracer.apps.demo.sequence import Sequence, open_sequence

NEEDED = {"rich": "demo", "PIL": "demo"}
NEEDED_BY_NODE = {"rclpy": "ros", "sensor_msgs": "ros", **NEEDED}
# what a machine without a CUDA device answers in half a minute, and one with it in less
CPU_FRAMES, CPU_SIZE = 40, (640, 480)
CUDA_FRAMES, CUDA_SIZE = 72, (640, 480)
ANIMATION_HEIGHTS = (60, 1080)


def missing(node: bool) -> str:
    """What is not installed and how to get it; empty if all is there."""
    needed = NEEDED_BY_NODE if node else NEEDED
    absent = [name for name in needed if importlib.util.find_spec(name) is None]
    if not absent:
        return ""
    extras = ",".join(sorted({needed[name] for name in absent}))
    return f"the demo needs {', '.join(absent)}: pip install 'shadow_tracer[{extras}]' (or run `make demo`)"


def perform(chosen: argparse.Namespace) -> None:
    """Plays the sequence and saves the pictures.

    Raises:
        DemoError: if a process fails, there is no such device, or no mask comes back.
        ValueError: if an option or the data folder is wrong.
    """
    from rich.console import Console

    from shadow_tracer.apps.demo.library_run import LibraryRun
    from shadow_tracer.apps.demo.pictures import percent_lit, save_animation
    from shadow_tracer.apps.demo.studio import save_portrait

    start = time.monotonic()
    console = Console()
    sequence = open_sequence(chosen.data, chosen.mesh, chosen.frames, chosen.size)
    chosen.output.mkdir(parents=True, exist_ok=True)
    what = f"{sequence.title}: {len(sequence.triangles):,} triangles, {len(sequence)} views"
    if chosen.node:
        recording = _through_the_node(chosen, sequence, console, what)
    else:
        console.print(f"[dim]{what}, no ROS (--node plays them through the node)[/dim]")
        run = LibraryRun(sequence, chosen.pipeline, chosen.variant, chosen.device)
        recording = run.play(console, chosen.budget, chosen.animation_height)
    facts = _facts(sequence, recording)
    table = stage_times.rows(recording.times)
    saved = save_portrait(recording.still, sequence, chosen.output, [str(v) for v in facts.values()])
    saved.append(chosen.output / "shadows.gif")
    starts = list(recording.panels)
    # a frame that was left out leaves its time to the one before
    durations = [sequence.frame_time * (b - a) for a, b in zip(starts, [*starts[1:], sequence.animated], strict=True)]
    save_animation(list(recording.panels.values()), saved[-1], durations)
    saved += stage_times.save(chosen.output, sequence.title, facts, table)
    _show(console, table, facts, saved)
    still = recording.still
    reach = ", ".join(f"{name} {percent_lit(mask, still.depth):.0f} %" for name, mask in still.masks.items())
    console.print(f"Of the pixels of the still are lit: {reach}")
    console.print(f"[bold green]Done[/bold green] in {time.monotonic() - start:.0f} s.")
    if recording.skipped:
        console.print(f"[dim]{recording.skipped} frames were left out to save time (see --budget).[/dim]")
    if recording.lost:
        because = f": {recording.reason}" if recording.reason else " in time"
        console.print(f"[yellow]{recording.lost} frames were not answered{because}[/yellow]")


def _drive(chosen: argparse.Namespace) -> None:
    """The robot with the tube. Raises ValueError if an option or the mesh is wrong."""
    from rich.console import Console

    from shadow_tracer.apps.demo import uv

    console = Console()
    path = uv.perform(chosen, lambda text: console.print(text, soft_wrap=True, highlight=False))
    console.print(f"  {path}  [dim]{path.stat().st_size / 1e6:.2f} MB[/dim]", soft_wrap=True, highlight=False)


def _through_the_node(chosen: argparse.Namespace, sequence: Sequence, console: Any, what: str) -> Any:
    """The recording of what node and publisher, each in a process, said to each other."""
    from shadow_tracer.apps.demo.recording import Recorder, Report

    with Processes() as processes:
        console.print(f"[dim]{what}, ROS_DOMAIN_ID={processes.domain}[/dim]")
        path = processes.folder / "node.yaml"
        path.write_text(yaml(parameters(sequence, chosen.pipeline, chosen.variant, chosen.device)), encoding="utf-8")
        report = Report()
        processes.start("node", "shadow_tracer.ros.node.node", "--ros-args", "--params-file", str(path))
        processes.start(
            "publisher", "shadow_tracer.apps.demo.publisher", *_publisher_arguments(chosen), on_line=report.hear
        )
        return Recorder(sequence, processes, report, chosen.animation_height).run(console)


def _publisher_arguments(chosen: argparse.Namespace) -> list[str]:
    arguments = ["--size", "{}x{}".format(*chosen.size)]
    for option, value in (
        ("--frames", chosen.frames),
        ("--budget", chosen.budget),
        ("--data", chosen.data),
        ("--mesh", chosen.mesh),
    ):
        if value is not None:
            arguments += [option, str(value)]
    return arguments


def _facts(sequence: Sequence, recording: Any) -> dict[str, str]:
    """What was measured on what, in short texts."""
    device = recording.device
    width, height = recording.size
    return {
        "triangles": f"{len(sequence.triangles):,} triangles",
        "lights": ", ".join(light.name for light in sequence.lights),
        "image": f"{width} x {height} pixels",
        "pipeline": f"{device.get('pipeline', '?')} ({device.get('variant', '?')}) on {device.get('device', '?')}",
        "frames": f"{len(recording.times)} frames in {recording.seconds:.1f} s",
    }


def _show(console: Any, table: list[stage_times.StageRow], facts: dict[str, str], saved: list[Path]) -> None:
    from rich.table import Table

    console.print(f"Stage times: {facts['pipeline']}, {facts['image']}, {facts['triangles']}")
    view = Table()
    view.add_column("stage")
    view.add_column("median [ms]", justify="right")
    view.add_column("p95 [ms]", justify="right")
    for row in table:
        style = "bold" if row.stage in ("total", stage_times.WAY) else "dim" if "." in row.stage else ""
        name = "  " + row.stage.split(".", 1)[1] if "." in row.stage else row.stage
        view.add_row(name, f"{row.median:.2f}", f"{row.p95:.2f}", style=style)
    console.print(view)
    for path in saved:
        console.print(f"  {path}  [dim]{path.stat().st_size / 1e6:.2f} MB[/dim]", soft_wrap=True, highlight=False)


def _options() -> argparse.ArgumentParser:
    pipelines = available_pipelines()
    parser = argparse.ArgumentParser(
        prog="shadow_tracer demo",
        description="Lights a moving workshop, or recorded depth frames, and saves pictures of it.",
    )
    parser.add_argument(
        "--uv", action="store_true",
        help="a robot with a UV-C tube in a hospital room, or in the mesh --data FILE (z up); its dose as uv.gif",
    )  # fmt: skip
    parser.add_argument("--node", action="store_true", help="play it through the ROS 2 node over topics, not in here")
    publisher.options(parser)
    parser.add_argument("--output", type=Path, default=Path("demo_output"), metavar="FOLDER", help="where pictures go")
    parser.add_argument(
        "--animation-height", type=_height, default=360, metavar="PIXELS", help="height of the GIF (default: 360)"
    )
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda:N (default: auto)")
    parser.add_argument("--pipeline", choices=list(pipelines), help="default: light_grid, with --uv bvh")
    variants = sorted({variant for names in pipelines.values() for variant in names})
    parser.add_argument("--variant", default="", choices=["", *variants], help="default: the first of the pipeline")
    return parser


def _height(text: str) -> int:
    """Pixels of a text such as 360."""
    low, high = ANIMATION_HEIGHTS
    if not text.isdecimal() or not low <= int(text) <= high:
        raise argparse.ArgumentTypeError(f"animation-height: expected {low} to {high} pixels, got {text!r}")
    return int(text)


def _fill_in(chosen: argparse.Namespace) -> None:
    """Chooses what was left open so that the demo takes less than a minute."""
    if chosen.uv:
        chosen.pipeline = chosen.pipeline or "bvh"
        return
    chosen.pipeline = chosen.pipeline or "light_grid"
    cuda = chosen.device != "cpu" and Path("/dev/nvidia0").exists()
    chosen.size = chosen.size or (CUDA_SIZE if cuda else CPU_SIZE)
    if chosen.frames is None and chosen.data is None:
        chosen.frames = CUDA_FRAMES if cuda else CPU_FRAMES


class _Interrupts:
    """Turns SIGINT and SIGTERM into KeyboardInterrupt and remembers it: out of rclpy comes another error."""

    def __init__(self) -> None:
        self.came = False
        # also SIGINT: a shell without job control starts its children with it ignored
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._raise)

    def _raise(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Entry point: 0 if pictures were made, 1 if not, 2 for a wrong option or missing package, 130 when interrupted."""
    parser = _options()
    chosen = parser.parse_args(arguments)
    others = {"node": False, "mesh": None, "size": None, "budget": publisher.BUDGET}
    without = [name for name, default in others.items() if chosen.uv and getattr(chosen, name) != default]
    if without:
        parser.error(f"--{without[0]} does not go with --uv")
    _fill_in(chosen)
    if text := missing(chosen.node):
        print(text, file=sys.stderr)
        return 2
    from shadow_tracer.apps.demo.recording import DemoError

    interrupts = _Interrupts()
    try:
        (_drive if chosen.uv else perform)(chosen)
    except KeyboardInterrupt:
        pass
    except ValueError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    except (DemoError, RuntimeError) as error:
        if not interrupts.came:
            print(f"demo: {error}", file=sys.stderr)
            return 1
    if interrupts.came:
        print("demo: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
