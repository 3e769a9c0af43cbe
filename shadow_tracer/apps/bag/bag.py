# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer bag IN OUT`: the node's masks for every depth image of a recorded bag, without ROS or a clock.

What is in force at a frame is said in :mod:`bag_player`; here are options, errors and the summary.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from shadow_tracer import ShadowTracer
from shadow_tracer.apps.bag.names import Names, parameters_of
from shadow_tracer.ros.parameters.former_names import renamed
from shadow_tracer.ros.parameters.parameters import light_names, names_in, problems_in, settings_from, unknown_names
from shadow_tracer.ros.settings import Settings

if TYPE_CHECKING:
    from shadow_tracer.apps.bag.player import Player, Result
    from shadow_tracer.apps.bag.reader import Background, Recording
    from shadow_tracer.apps.bag.writer import Output

NEEDED = ("rosbags", "mcap", "zstandard", "yaml", "rich", "scipy")
UNKNOWN = 3  # exit code
_NOT_OURS = ("use_sim_time", "qos_overrides.", "start_type_description_service")

_DESCRIPTION = """\
Answers every depth image of a bag as the node would, and writes ~/mask, ~/mask/<light>, ~/light_bits, ~/camera_info,
~/query/visibility and ~/timing into a new bag; ~/visibility/<light> with --visibility, ~/irradiance and
~/irradiance/<light> with --irradiance. No ROS is needed.
Transforms, camera poses and camera_info are read before, so that none comes late; meshes, light poses and static
transforms that change are taken in the order of the log. The same bag and parameters give the same masks, bit by
bit."""

_EXIT_CODES = """exit code:
  0  the bag was written
  1  it was not, for the reason given
  2  a wrong option, or a package that is missing
  3  it was written, but nothing is known of any depth image; with --strict, of any one of them or of a query
  130  interrupted"""

_EXAMPLE = """\
example:
  shadow_tracer bag drive.mcap shadows.mcap --params-file rover.yaml --param lights.sun.enabled:=true \\
      --remap depth/image_rect:=/camera/depth/image_rect_raw --remap depth/camera_info:=/camera/depth/camera_info"""


def missing() -> str:
    """What is not installed and how to get it; empty if all is there."""
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    return f"to read bags {', '.join(absent)} is needed: pip install 'shadow_tracer[bag]'" if absent else ""


def load_settings(
    names: Names, files: Sequence[Path], given: Sequence[str], camera: str
) -> tuple[Settings, Names, list[str]]:
    """The node's settings from parameter files and ``name:=value``, and warnings about what has no effect.

    Args:
        names: of the node.
        files, given: as for ``ros2 run``.
        camera: of several, the one whose images are answered; "" where there is one without a name.

    Returns:
        Settings and names of the camera, and the warnings.

    Raises:
        ValueError: a file or a value is bad; one line for each.
    """
    values, former = renamed(parameters_of(names.node, files, given))
    if problems := problems_in(values):
        raise ValueError("\n".join(problems))
    settings, names = of_camera(settings_from(values), names, camera)
    ours = [name for name in values if not name.startswith(_NOT_OURS)]
    return settings, names, former + unknown_names(ours, names_in(values), light_names(values))


def of_camera(settings: Settings, names: Names, camera: str) -> tuple[Settings, Names]:
    """Settings and names for the images of one camera; "" is one without a name. Raises ValueError."""
    known = {each.name: each for each in settings.cameras}
    if camera in known:
        return settings.of(camera), names.of(known[camera])
    if known:
        raise ValueError(f"--camera: expected one of {', '.join(known)}, cameras of the parameters, got {camera!r}")
    if camera:
        raise ValueError(f"--camera: expected none, the parameters have no camera_names, got {camera!r}")
    return settings, names


def perform(chosen: argparse.Namespace) -> int:
    """Do what the options ask for. Returns the exit code, 0 or 3.

    Raises:
        BagError: a bag cannot be read or written.
        ValueError: a parameter, a name or a mesh file is bad.
        RuntimeError: the tracer cannot be made.
    """
    from shadow_tracer.apps.bag.player import Player, Wish
    from shadow_tracer.apps.bag.reader import Recording, read_background
    from shadow_tracer.apps.bag.writer import Output

    start = time.monotonic()
    names = Names(chosen.node, chosen.remap)
    settings, names, warnings = load_settings(names, chosen.params_file, chosen.param, chosen.camera)
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    lights = [light.name for light in settings.lights if light.type != "sun"]
    wish = Wish(**wishes(chosen))
    source = Recording(chosen.bag, names, lights, settings.max_rays)
    with source as recording, Output(chosen.output, chosen.overwrite) as output:
        for line in (*recording.notes, *(f"warning: {text}" for text in recording.warnings)):
            print(line, file=sys.stderr)
        background = read_background(recording, settings)
        tracer = ShadowTracer(
            settings.pipeline, settings.variant or None, device=settings.tracer_device, bounds=settings.bounds,
            threads=settings.threads or None,
        )  # fmt: skip
        tracer.warm_up()
        player = Player(recording, background, settings, tracer, output, names, wish)
        result = _play(player, recording)
        advice = [*player.meshes.left_out, *player.dose.troubles, *_advice(recording, background, settings, result)]
    _summarise(result, output, player, tracer, time.monotonic() - start)
    for line in advice:
        print(f"warning: {line}", file=sys.stderr)
    # a depth image or a query that was refused is not answered either
    incomplete = bool(result.reasons or {"depth", "query"} & result.refused.keys())
    return UNKNOWN if not result.traced or (chosen.strict and incomplete) else 0


def _by_several(chosen: argparse.Namespace) -> int:
    """The same by several processes. Returns the exit code, 0, 1, 2 or 3."""
    # Not imported above: the program for many bags is over that for one.
    bags = importlib.import_module("shadow_tracer.apps.bags.bags")

    if chosen.output.suffix == ".mcap":
        raise ValueError(f"{chosen.output}: with --jobs OUT is a folder; choose a name without .mcap")
    more = ["--jobs", str(chosen.jobs), *(["--restart"] if chosen.overwrite else [])]
    return int(bags.one_bag(chosen, more))


def _play(player: Player, recording: Recording) -> Result:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("frames"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("frames", total=recording.count("depth"))
        return player.play(lambda: progress.advance(task))


def _advice(recording: Recording, background: Background, settings: Settings, result: Result) -> list[str]:
    """What was doubtful, a sentence each."""
    from shadow_tracer.apps.bag.reader import MESHES
    from shadow_tracer.ros.node.processing import named_in_vain

    said = [f"{text} ({count} frames)" for text, count in result.warnings.items()]
    said += [f"unknown, {count} times: {text}" for text, count in result.reasons.values()]
    said += [
        f"{name}: {count} messages were refused, the last one because of {text}"
        for name, (count, text) in sorted(result.refused.items())
    ]
    if settings.uses_meshes and not recording.count(*MESHES) and not any(settings.mesh_files):
        topics = ", ".join(MESHES)
        said.append(f"the bag has no mesh ({topics}) and mesh.files is empty; see --remap")
    if in_vain := named_in_vain(settings, result.parts):
        said.append(f"{in_vain}; correct the name")
    if result.passes > 1:
        said.append(
            f"the images start again {result.passes - 1} times at an earlier stamp: what belongs to a stamp is "
            "taken from all passes together; cut the bag"
        )
    if settings.pose_source == "topic" and not len(background.poses):
        said.append("pose_source is topic, but the bag has no camera_pose; see --remap")
    if result.differing:
        said.append(f"{result.differing} pixels differ between two pipelines; please report this")
    return said


def _summarise(result: Result, output: Output, player: Player, tracer: ShadowTracer, seconds: float) -> None:
    rate = result.frames / seconds if seconds > 0.0 else 0.0
    unknown = result.frames - result.traced
    print(
        f"{result.frames} frames in {seconds:.1f} s ({rate:.1f} per second): {result.traced} traced, {unknown} unknown"
    )
    print(f"{tracer.pipeline}/{tracer.variant} on {tracer.device}")
    store = player.meshes.store
    print(
        f"{player.meshes.received} mesh messages, {store.triangle_count} triangles in {len(store.parts)} parts at "
        "the end"
    )
    if result.verified:
        print(f"{result.verified} frames traced by a second pipeline too, {result.differing} pixels differ")
    for topic, count in sorted(output.counts.items()):
        print(f"  {topic}  {count}")
    print(f"{output.path}")


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Options of the node that the program stands for."""
    parser.add_argument(
        "--params-file",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="parameters of the node, as for ros2 run; may be repeated",
    )
    parser.add_argument(
        "--param",
        action="append",
        default=[],
        metavar="NAME:=VALUE",
        help="one parameter; counts more than files; may be repeated",
    )
    parser.add_argument(
        "--remap",
        action="append",
        default=[],
        metavar="FROM:=TO",
        help="another name for a topic, as for ros2 run; may be repeated",
    )
    parser.add_argument(
        "--camera", default="", metavar="NAME", help="whose images, where the parameters name several (camera_names)"
    )
    parser.add_argument(
        "--node",
        default="/shadow_tracer",
        metavar="NAME",
        help="full name of the node, for topics and parameter files (default: %(default)s)",
    )


def add_wishes(parser: argparse.ArgumentParser) -> None:
    """Options of what is written."""
    parser.add_argument(
        "--visibility", action="store_true", help="also write ~/visibility/<light>, the part that is seen, 0 to 1"
    )
    parser.add_argument(
        "--irradiance", action="store_true", help="also write ~/irradiance and ~/irradiance/<light> [W/m2]"
    )
    parser.add_argument(
        "--sun-map", action="store_true", help="also write ~/sun_map, hours of sun on the ground of a grid_map"
    )
    parser.add_argument("--overlay", action="store_true", help="also write ~/overlay, pictures for people")
    parser.add_argument(
        "--no-timing", action="store_true", help="leave out ~/timing, all that differs between two runs"
    )
    parser.add_argument("--copy", action="store_true", help="also copy everything of IN but topics of these names")


def wishes(chosen: argparse.Namespace) -> dict[str, bool]:
    """What is written, by the names of :class:`Wish`."""
    names = ("overlay", "copy", "visibility", "irradiance", "sun_map")
    return {"timing": not chosen.no_timing, **{name: bool(getattr(chosen, name)) for name in names}}


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="shadow_tracer bag",
        description=_DESCRIPTION,
        epilog=f"{_EXIT_CODES}\n\n{_EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, metavar="IN", help="an mcap, db3 or ROS 1 bag file, or the folder of a bag")
    parser.add_argument("output", type=Path, metavar="OUT", help="new file *.mcap, or the folder of a new bag")
    add_parameters(parser)
    add_wishes(parser)
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="N processes; OUT is then the folder of a new split bag, "
        "and the same command goes on where it was interrupted; see also: shadow_tracer bags",
    )
    parser.add_argument(
        "--strict", action="store_true", help="exit code 3 if nothing is known of any one depth image or query"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace OUT if it exists")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Returns the exit code, which ``--help`` explains."""
    chosen = _options().parse_args(arguments)
    if text := missing():
        print(text, file=sys.stderr)
        return 2
    from shadow_tracer.apps.bag.files import BagError

    try:
        if chosen.output.exists() and chosen.bag.exists() and chosen.output.samefile(chosen.bag):
            raise BagError(f"{chosen.output}: is the bag that is read; choose another name")
        if chosen.jobs is not None:
            return _by_several(chosen)
        return perform(chosen)
    except KeyboardInterrupt:
        print("bag: interrupted, nothing was written", file=sys.stderr)
        return 130
    except (BagError, ValueError, RuntimeError, ImportError, OSError) as error:
        print(f"bag: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
