# SPDX-License-Identifier: Apache-2.0
"""The benchmark suite: every pipeline and variant beside brute force, Embree, wp.Mesh, Open3D and a shadow map.

All answer the same rays in the same run on the same cores. A time is given out only for answers that were compared,
all of every timed frame. Ours: all rays with ``mesh_bvh``, and ``mesh_bvh`` on a random subset with ``brute_force``;
one difference and the program stops. Peers, which work in float32: the largest number of wrong rays is in the table,
and with more than one in a thousand there is no time. On a virtual machine frames during which the host took the
processors away are measured again, and do not count if there are others.

dynamic: mesh and depth image are new in every frame. Ours is the whole of ``ShadowTracer.trace``, numpy to numpy; the
peers' is structure and query, on rays that were made before. static: only the depth image is new; the peers' is the
query alone. ratio: the better peer, with its build (dynamic) or without (static), over ours. growth: by how much the
time has grown since the row before, in parts of how much rays, triangles or lights have; 1 is linear.

Sections: scenes, points (of ``occluded``), variants, rays, triangles, lights, maps (how many pixels a shadow map gets
wrong), memory. Each has its budget of seconds; what does not fit is left out, and said.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import suite_maps
import suite_memory
import suite_points
import suite_scaling
import suite_scenes
import suite_targets
from report import header, machine, note, table, threads
from rivals import missing
from scenes import names
from suite_settings import SECTIONS, Clock, Rows, Settings, choose, full, quick

_RUN = {
    "scenes": suite_scenes.scenes,
    "points": suite_points.points,
    "variants": suite_scenes.variants,
    "rays": suite_scaling.rays,
    "triangles": suite_scaling.triangles,
    "lights": suite_scaling.lights,
    "maps": suite_maps.maps,
    "memory": suite_memory.memory,
}
_CONTEST = ("method", "dynamic ms", "static ms", "dynamic ratio", "static ratio", "frames", "wrong rays")
_SCALING = ("view", "method", "triangles", "rays", "lights", "dynamic ms", "dynamic ratio", "growth", "wrong rays")
_COLUMNS = {
    "scenes": _CONTEST,
    "points": ("view", "triangles", "rays", *_CONTEST),
    "variants": ("method", "dynamic ms", "static ms", "frames", "wrong rays"),
    "rays": _SCALING,
    "triangles": _SCALING,
    "lights": _SCALING,
    "maps": ("view", "rasteriser", "map", "maps", "wrong %", "bias", "ms (not exact)"),
    "memory": ("method", "device MB", "loaded MB", "peak MB", "more MB"),
}
_MEANING = {
    "scenes": "All on every view",
    "points": "occluded(points), in random order",
    "variants": "All variants of all pipelines",
    "rays": "More rays",
    "triangles": "More triangles",
    "lights": "More lights",
    "maps": "Shadow maps: pixels they get wrong",
    "memory": "Memory: reserved on the device, resident before and at most, and the difference",
}


def run(
    settings: Settings,
    sections: list[str],
    quiet: bool = False,
    stages: bool = False,
    keep: Callable[[dict[str, Any]], None] = lambda found: None,
) -> dict[str, Any]:
    """Measure; returns per section its ``rows``, what was ``left_out``, and its ``seconds``. After each section all
    that there is goes to ``keep``: an error in a later one loses nothing.
    """
    found: dict[str, Any] = {}
    saved = 0.0
    for section in sections:
        clock = Clock(section, settings.budget[section] + saved, quiet)
        rows = _RUN[section](settings, clock)
        saved = max(clock.seconds - clock.spent, 0.0)
        found[section] = {"rows": rows, "left_out": clock.left_out, "seconds": clock.spent}
        keep(found)
        if not quiet:
            show(section, found[section], stages)
    return found


def write(path: Path, results: dict[str, Any]) -> None:
    """Write a file, or leave it as it was: whoever reads it sees the whole of one or of the other."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        part.write_text(json.dumps(results, indent=1) + "\n")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def show(section: str, found: dict[str, Any], stages: bool) -> None:
    """Print a section's tables as Markdown; with ``stages`` what each of ours did in its last dynamic frame."""
    print(f"\n## {_MEANING[section]} ({found['seconds']:.0f} s)\n")
    rows: Rows = found["rows"]
    per_view = section in ("scenes", "variants")
    for view in dict.fromkeys(row["view"] if per_view else "" for row in rows):
        shown = [row for row in rows if view in ("", row["view"])]
        if per_view:
            print(f"{view}: {shown[0]['triangles']:,} triangles, {100 * shown[0]['in shadow']:.0f} % in shadow\n")
        table([{name: row[name] for name in _COLUMNS[section]} for row in shown])
        for row in shown if stages and per_view else ():
            for what in ("stages", "counters"):
                if row.get(what):
                    parts = ", ".join(f"{name} {value:.4g}" for name, value in row[what].items())
                    print(f"{row['method']} {what}: {parts}")
        print(flush=True)
    if found["left_out"]:
        note(f"left out, the budget of seconds was spent: {', '.join(found['left_out'])}")


def arguments() -> tuple[argparse.Namespace, Settings]:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small images and few views: under a minute")
    parser.add_argument("--sections", nargs="+", default=list(SECTIONS), choices=SECTIONS, metavar="SECTION")
    parser.add_argument("--budget", type=float, default=1.0, help="factor on the seconds of each section")
    parser.add_argument("--size", type=int, help="image width and height [px]")
    parser.add_argument("--views", nargs="+", metavar="VIEW", help=f"all, or some of: {', '.join(names())}")
    parser.add_argument("--pipelines", nargs="+", metavar="NAME", help="pipelines, or pipeline/variant")
    parser.add_argument("--frames", type=int, help="frames per figure")
    parser.add_argument("--seconds", type=float, help="seconds after which a figure gets no further frames")
    parser.add_argument("--threads", type=int, help="cores for each method, ours or a peer's; default: all")
    parser.add_argument("--stages", action="store_true", help="print ours' milliseconds per stage and counters, too")
    parser.add_argument("--out", type=Path, help="folder for results.json and the plots")
    options = parser.parse_args()
    options.threads = options.threads or len(os.sched_getaffinity(0))
    settings = (quick if options.quick else full)(options.budget)
    for name in options.views or []:
        if name not in (*names(), "all"):
            parser.error(f"--views: expected all or some of {', '.join(names())}, got {name!r}")
    if options.views:
        chosen = tuple(names() if options.views == ["all"] else options.views)
        settings = replace(settings, views=chosen, views_few=chosen[: len(settings.views_few)])
    try:
        pairs = choose(options.pipelines or [])
    except ValueError as error:
        parser.error(f"--{error}")
    if pairs:
        settings = replace(settings, pipelines=pairs, every=pairs, held=())
    given = {key: value for key in ("frames", "seconds") if (value := getattr(options, key)) is not None}
    settings = replace(settings, effort=replace(settings.effort, **given), size=options.size or settings.size)
    return options, settings


def main() -> None:
    """Measure, print, and write."""
    options, settings = arguments()
    begin = time.perf_counter()
    title = "shadow_tracer benchmark suite" + (" (quick)" if options.quick else "")
    header(title)
    print(threads(options.threads))
    for peer, why in missing().items():
        note(f"{peer} takes no part, it cannot be imported: {why}")
    results = {"title": title, "machine": machine(), "threads": options.threads, "settings": asdict(settings)}
    results["absent"] = missing()

    def keep(found: dict[str, Any]) -> None:
        reached = suite_targets.targets({section: result["rows"] for section, result in found.items()})
        results.update(sections=found, targets=reached)
        if options.out:
            write(options.out / "results.json", results)

    run(settings, options.sections, stages=options.stages, keep=keep)
    if results["targets"]:
        print("\n## Targets\n")
        table(results["targets"])
    print(f"\n{time.perf_counter() - begin:.0f} s in all")
    if options.out:
        try:
            import plots
        except ImportError as error:
            note(f"no plots: {error}")
        else:
            plots.draw(results, options.out)
        print(f"results.json and plots are in {options.out}")


if __name__ == "__main__":
    main()
