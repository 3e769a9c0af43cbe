# SPDX-License-Identifier: Apache-2.0
"""The experiments of "Fast GPU Ray Tracing of Dynamic Meshes using Geometry Images" (Carr, Hoberock, Crane, Hart 2006;
the paper of ``geometry_image``) again: Table 1 and figure 7, rays per second against the resolution of the image;
figure 10, beside other structures; figure 11, what coarser images get wrong; Table 2, bits for a node and a triangle.

The paper's models are cut and flattened by others' programs; here a bumpy ball, closed along its ends, is the image of
a function, 513 x 513, and coarser ones are levels of detail of that (``put_surface(level=)``). All rays are shadow
rays, which end at whatever they meet first, as nothing else is asked here:

- *eye*: from a wall behind the model to a lamp at the eye, one for each pixel; *blend*: the same while the ball
  changes its shape in every frame; *lens*: to eight places of a lens in turn (the paper's depth of field, without its
  random order); *side*: from the model to a lamp beside it (instead of glossy reflections); *several*: three small
  balls over a wide ground, to the eye.

A time is processor time of a whole frame of one thread, numpy to numpy, the least of a few; every mask is compared with
that of ``mesh_bvh`` before it is given. *blend* has the new positions' checks and copies on the host with it; what
boxes take is timed within it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from papers import axes_style, plotting, readable, save
from report import compact, header, table, threads, write_json

from shadow_tracer import Bounds, Camera, DepthCamera, Mesh, PointLight, Scene, ShadowTracer
from shadow_tracer.gpu.accelerators.geometry_image.geometry_image import GeometryImages
from shadow_tracer.gpu.accelerators.geometry_image.images import FLOATS, layout_of

_FINEST = 512  # quads along a side
_LEVELS = range(8)  # 512 to 4; of two by two quads the ball has no volume
# Millions of rays a second in the paper's Table 1: eye, blend, depth of field, glossy, several. Cells of its shortest
# rows cannot be told apart in the text that was at hand, but for the first.
_PAPER: dict[int, tuple[float | None, ...]] = {
    4: (29.4, None, None, None, None),
    8: (10.1, 9.31, None, None, 12.5),
    16: (6.25, 5.71, None, None, 9.56),
    32: (3.70, 3.30, None, None, 6.56),
    64: (2.25, 2.23, 1.97, 4.32, 4.35),
    128: (1.37, 1.35, 1.21, 2.80, 2.85),
    256: (0.818, 0.802, 0.706, 1.78, 1.83),
    512: (0.462, 0.453, 0.348, 1.14, 1.08),
}
_KINDS = ("eye", "blend", "lens", "side", "several")
_PEERS = (
    ("mesh_bvh", "refit"),
    ("bvh", "sah"),
    ("bvh", "threaded"),
    ("uniform_grid", "dda"),
    ("kd_tree", "sah"),
    ("light_grid", "packed"),
)
_EYE = (0.0, 0.0, -4.0)


def ball(size: int, phase: float = 0.0) -> np.ndarray:
    """(size + 1, size + 1, 3) positions of a closed surface with bumps of several sizes, of radius about 1."""
    down, around = np.pi * np.arange(size + 1)[:, None] / size, 2.0 * np.pi * (np.arange(size + 1) % size) / size
    x, y, z = np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down) * np.ones_like(around)
    radius = 1.0 + 0.12 * np.sin(5.0 * x + phase) * np.cos(4.0 * y) + 0.05 * np.sin(13.0 * z + 11.0 * x - phase)
    radius += 0.01 * np.sin(41.0 * x + 37.0 * y + 43.0 * z)
    return np.stack([radius * x, radius * y, radius * z], axis=-1)


def ground(size: int) -> np.ndarray:
    """(size + 1, size + 1, 3) positions of a wide ground below the balls."""
    u, v = np.meshgrid(np.linspace(-3.0, 3.0, size + 1), np.linspace(-3.0, 3.0, size + 1))
    return np.stack([u, 0.8 + 0.1 * np.sin(3.0 * u) * np.cos(2.0 * v), v], axis=-1)


@dataclass(frozen=True)
class Asked:
    """Rays of an experiment.

    Attributes:
        depth: (H, W) of the samples, NaN where there is none.
    """

    kind: str
    depth: np.ndarray
    camera: Camera
    lights: list[PointLight]


def put(scene: Scene, kind: str, level: int) -> None:
    """What is asked about in an experiment, and nothing else."""
    scene.clear()
    if kind != "several":
        scene.put_surface("ball", ball(_FINEST), level=level)
        return
    scene.put_surface("ground", ground(_FINEST), level=level)
    for number in range(3):
        place = np.array((0.5 * (number - 1), 0.6, 0.2 * number))
        scene.put_surface(f"ball {number}", 0.1 * ball(_FINEST, float(number)) + place, level=level)


def asked(kind: str, size: int, level: int) -> Asked:
    """The rays of an experiment at a level of detail."""
    pose = np.eye(4)
    pose[:3, 3] = _EYE
    camera = Camera(size, size, 1.2 * size, 1.2 * size, 0.5 * size - 0.5, 0.5 * size - 0.5, pose)
    depth, lights = np.full((size, size), 8.0, np.float32), [PointLight("eye", _EYE)]
    if kind == "lens":
        lights = [PointLight(f"eye {k}", (0.2 * np.cos(k), 0.2 * np.sin(k), -4.0)) for k in range(8)]
    elif kind == "side":
        lights = [PointLight("lamp", (4.0, -3.0, -2.0))]
        scene = Scene(Bounds(max_triangles=2 * _FINEST**2))
        put(scene, kind, level)
        bounds = Bounds(max_triangles=2 * _FINEST**2, max_rays=size * size)
        depth, _ = DepthCamera("cpu", bounds).render(scene, camera)
    return Asked(kind, depth, camera, lights)


@contextmanager
def timed_boxes() -> Iterator[list[float]]:
    """Seconds that each making of boxes takes meanwhile."""
    make, spent = GeometryImages.make, list[float]()

    def timed(images: GeometryImages) -> Sequence[Mesh]:
        begin = time.process_time()
        others = make(images)
        spent.append(time.process_time() - begin)
        return others

    with mock.patch.object(GeometryImages, "make", timed):
        yield spent


class Bench:
    """Traces by a pipeline, and by ``mesh_bvh``, with which every mask is compared."""

    def __init__(self, size: int, device: str) -> None:
        self._bounds = Bounds(max_triangles=8 * _FINEST**2, max_rays=size * size, max_lights=8)
        self._device = device
        self.tracer = self._made("geometry_image", None)
        self._oracle = self._made("mesh_bvh", None)

    def _made(self, pipeline: str, variant: str | None) -> ShadowTracer:
        return ShadowTracer(pipeline, variant, device=self._device, bounds=self._bounds, threads=1)

    def select(self, pipeline: str, variant: str) -> None:
        """Trace by another pipeline from now on."""
        self.tracer = self._made(pipeline, variant)

    def measure(self, rays: Asked, level: int, frames: int, changing: bool = False) -> dict[str, Any]:
        """Milliseconds of a frame, and counts a ray.

        Raises:
            SystemExit: a mask differs from that of ``mesh_bvh``.
        """
        put(self.tracer.scene, rays.kind, level)
        shapes = [ball(_FINEST, 0.3 * number) for number in range(frames)]
        host, whole, boxes = [], [], []
        frame: Any = None
        for number in range(frames + 1):
            with timed_boxes() as spent:
                begin = time.process_time()
                if changing:
                    self.tracer.scene.deform_surface("ball", shapes[number % frames])
                between = time.process_time()
                frame = self.tracer.trace(rays.depth, rays.camera, rays.lights, bias=1e-3)
                whole.append(time.process_time() - begin)
            host.append(between - begin)
            boxes.append(sum(spent))
        self._compare(frame, rays)
        asking = frame.counters["rays"]
        return {
            "ms": 1e3 * min(whole[1:]),
            "host ms": 1e3 * min(host[1:]),
            "boxes ms": 1e3 * min(boxes[1:]),
            "rays": asking,
            "Mrays/s": 1e-6 * asking / min(whole[1:]),
            "nodes/ray": frame.counters["nodes_visited"] / asking,
            "tests/ray": frame.counters["leaf_tests"] / asking,
            "states": np.array([frame.state(light.name) for light in rays.lights]),
        }

    def _compare(self, frame: Any, rays: Asked) -> None:
        theirs = self._oracle.scene
        theirs.clear()
        for mesh in self.tracer.scene:
            theirs.put(mesh.name, mesh.vertices, mesh.triangles)
        expected = self._oracle.trace(rays.depth, rays.camera, rays.lights, bias=1e-3)
        if frame.differing(expected):
            way = f"{self.tracer.pipeline}/{self.tracer.variant}"
            raise SystemExit(f"{rays.kind}: {way} differs from mesh_bvh in {frame.differing(expected)} pixels")


def table_1(bench: Bench, size: int, frames: int) -> list[dict[str, Any]]:
    """All experiments at all resolutions, each beside the paper's figure, and what a coarser image gets wrong."""
    rows, finest = [], {}
    for kind in _KINDS:
        for level in _LEVELS:
            quads = _FINEST >> level
            found = bench.measure(asked(kind, size, level), level, frames, changing=kind == "blend")
            states = found.pop("states")
            finest.setdefault(kind, states)
            # Of the side lamp the samples are others at each level, as is what lies before them.
            wrong = float((states != finest[kind]).mean()) if kind in ("eye", "several") else None
            paper = _PAPER[quads][_KINDS.index(kind)]
            rows.append({"kind": kind, "quads": quads, **found, "wrong": wrong, "paper": paper})
    return rows


def figure_10(bench: Bench, size: int, frames: int) -> list[dict[str, Any]]:
    """Other structures over the same triangles, and the same rays to the eye; and while the ball changes."""
    rows = []
    for level in (2, 1):
        still, changing = (asked(kind, size, level) for kind in ("eye", "blend"))
        for names in (("geometry_image", "threaded"), *_PEERS):
            bench.select(*names)
            found = bench.measure(still, level, frames)
            del found["states"]
            found["changing ms"] = bench.measure(changing, level, frames, changing=True)["ms"]
            rows.append({"structure": "/".join(names), "triangles": 2 * (_FINEST >> level) ** 2, **found})
    return rows


def table_2() -> list[dict[str, Any]]:
    """Bits for a node and for a triangle, with the paper's; of a ray's way nothing is stored."""
    nodes = sum(layout_of(_FINEST, _FINEST).nodes) / (2 * _FINEST**2)
    corners = (_FINEST + 1) ** 2 / (2 * _FINEST**2)
    return [
        {"": "node", "here": 32.0 * FLOATS, "paper": 160.0},
        {"": "nodes for a triangle", "here": nodes, "paper": 2.0 / 3.0},
        {"": "triangle, coordinates", "here": 3 * 64 * corners, "paper": 24.0},
        {"": "triangle, numbers of its corners", "here": 3 * 32.0, "paper": 0.0},
    ]


def show(rows: list[dict[str, Any]]) -> None:
    """Print Table 1, a line for each resolution."""
    for kind in _KINDS:
        print(kind)
        own = [row for row in rows if row["kind"] == kind]
        table(
            [
                {key: row[key] for key in ("quads", "Mrays/s", "paper", "nodes/ray", "tests/ray", "ms", "wrong")}
                for row in own
            ]
        )
        print()
    still, changing = ([row for row in rows if row["kind"] == kind] for kind in ("eye", "blend"))
    shares = []
    for one, other in zip(still, changing, strict=True):
        frame = {"quads": one["quads"], "still ms": one["ms"], "changing ms": other["ms"]}
        shares.append(frame | {key: other[key] for key in ("host ms", "boxes ms")})
        shares[-1]["boxes' share"] = other["boxes ms"] / other["ms"]
    table(shares)
    print(flush=True)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Rays a second against resolution, ours and the paper's, and what is wrong."""
    pyplot = plotting()
    figure, places = pyplot.subplots(1, 3, figsize=(11.0, 3.4), layout="constrained")
    for k, kind in enumerate(_KINDS):
        own = [row for row in rows if row["kind"] == kind]
        style: dict[str, Any] = {"color": f"C{k}", "marker": ".", "linewidth": 1.2}
        places[0].plot([r["quads"] for r in own], [r["Mrays/s"] for r in own], label=kind, **style)
        known = [r for r in own if r["paper"] is not None]
        places[0].plot([r["quads"] for r in known], [r["paper"] for r in known], linestyle=":", **style)
        places[1].plot([r["quads"] for r in own], [r["nodes/ray"] for r in own], label=kind, **style)
        if own[0]["wrong"] is not None:
            some = [r for r in own if r["wrong"]]
            places[2].plot([r["quads"] for r in some], [100.0 * r["wrong"] for r in some], label=kind, **style)
    x = "quads along a side"
    axes_style(places[0], "Table 1 (dotted: the paper's GPU)", x, "million rays/s")
    axes_style(places[1], "Nodes", x, "nodes a ray")
    axes_style(places[2], "Figure 11: unlike 512 x 512", x, "pixels [%]")
    for axes in places:
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        readable(axes)
        axes.legend(fontsize=7)
    save(figure, path)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512, help="image width and height; the paper: 512")
    parser.add_argument("--frames", type=int, default=5, help="frames per figure")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--out", type=Path, help="folder for the picture; none is drawn without it")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    title = f"Geometry images: the paper's Tables 1 and 2, figures 7, 10 and 11, {options.size} x {options.size}"
    header(title)
    print(threads(1) + "\n")
    bench = Bench(options.size, options.device)
    rows = table_1(bench, options.size, options.frames)
    show(rows)
    write_json(title, rows, options.json)
    peers = figure_10(bench, options.size, options.frames)
    shown = ("structure", "triangles", "Mrays/s", "nodes/ray", "tests/ray", "ms", "changing ms")
    table([{key: row[key] for key in shown} for row in peers])
    print(flush=True)
    table(table_2())
    print("\nrays of a frame: " + ", ".join(f"{r['kind']} {compact(r['rays'])}" for r in rows if r["quads"] == _FINEST))
    write_json(title, rows + peers, options.json)
    if options.out:
        draw(rows, options.out / "papers_geometry_image.png")


if __name__ == "__main__":
    main()
