# SPDX-License-Identifier: Apache-2.0
"""What further lights cost: one depth image, 1, 2, 4 ... lights around it, per pipeline.

A time is printed only for masks that were compared with ``mesh_bvh``, every light of every timed frame. dynamic: the
mesh is new in every frame; static: nothing has changed. marginal: what a further light costs on average, in parts of
what the first costs alone.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from peers import choose
from report import header, table, threads, write_json
from rivals import Rays
from scenes import View, names, views

from shadow_tracer import Bounds, DirectionalLight, PointLight, ShadowTracer


def around(view: View, count: int) -> list[PointLight]:
    """The view's light and others on a circle around it, half as far from it as the middle of the samples is."""
    if isinstance(view.light, DirectionalLight):
        raise SystemExit(f"--views: expected views with a point light, got {view.name!r}")
    middle = Rays(view).points.mean(axis=0)
    first = np.asarray(view.light.position)
    forward = middle - first
    distance = float(np.linalg.norm(forward))
    side = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    side /= np.linalg.norm(side)
    up = np.cross(side, forward / distance)
    angles = 2.0 * np.pi * np.arange(count - 1) / max(count - 1, 1)
    others = [first + 0.5 * distance * (np.cos(a) * side + np.sin(a) * up) for a in angles]
    return [PointLight(f"lamp {k}", tuple(position)) for k, position in enumerate([first, *others])]


def measure(view: View, pipeline: str, variant: str, counts: list[int], frames: int) -> list[dict[str, Any]]:
    """Rows of one pipeline.

    Raises:
        SystemExit: a mask is wrong.
    """
    most = max(counts)
    rays, lights = Rays(view), around(view, most)
    pixels = view.camera.width * view.camera.height
    bounds = Bounds(max_triangles=most * len(view.triangles), max_rays=most * pixels)
    ours = ShadowTracer(pipeline, variant, "cpu", bounds)
    reference = ShadowTracer("mesh_bvh", None, "cpu", bounds)
    expected = []
    for positions in view.positions:
        reference.scene.put("mesh", positions, view.triangles)
        frame = reference.trace(rays.depth, view.camera, lights, bias=view.bias)
        expected.append([frame.state(light.name) for light in lights])
    ours.scene.put("mesh", view.positions[0], view.triangles)
    rows = []
    for moving in (True, False):
        first = 0.0
        for count in counts:
            times = []
            for k in range(frames + 2):
                at = k % len(view.positions) if moving else 0
                begin = time.perf_counter()
                if moving or k == 0:
                    ours.scene.deform("mesh", view.positions[at])
                frame = ours.trace(rays.depth, view.camera, lights[:count], bias=view.bias)
                times.append(time.perf_counter() - begin)
                for light, state in zip(lights[:count], expected[at], strict=False):
                    if not np.array_equal(frame.state(light.name), state):
                        raise SystemExit(f"{view.name}: {pipeline}/{variant} is wrong for {light.name}")
            milliseconds = 1e3 * float(np.median(times[2:]))
            first = first or milliseconds / count
            row = {"view": view.name, "method": f"{pipeline}/{variant}", "mesh": "dynamic" if moving else "static"}
            marginal = (milliseconds - first) / (count - 1) / first if count > 1 else None
            rows.append({**row, "lights": count, "ms": milliseconds, "marginal": marginal})
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height [px]")
    parser.add_argument("--frames", type=int, default=9, help="frames per figure")
    parser.add_argument("--lights", type=int, nargs="+", default=[1, 2, 4], help="numbers of lights, ascending from 1")
    parser.add_argument("--views", nargs="+", default=["workshop"], metavar="VIEW", choices=names())
    parser.add_argument(
        "--pipelines", nargs="+", default=["light_grid/packed", "cone_hierarchy/linear", "mesh_bvh/refit"]
    )
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    if options.lights != sorted(options.lights) or options.lights[0] != 1:
        parser.error(f"--lights: expected ascending numbers from 1 on, got {options.lights}")
    confined = threads(1)
    title = f"Several lights, {options.size} x {options.size}, one thread"
    header(title)
    print(confined + "\n")
    rows: list[dict[str, Any]] = []
    for view in views(options.size, options.views):
        for pipeline, variant in choose(options.pipelines):
            rows += measure(view, pipeline, variant, options.lights, options.frames)
    table(rows)
    write_json(title, rows, options.json)


if __name__ == "__main__":
    main()
