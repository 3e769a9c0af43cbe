# SPDX-License-Identifier: Apache-2.0
"""Whole traversals of rays and cones through the project's trees: nodes, triangles and time of each.

Nothing ends a traversal but the end of the ray or cone, and no triangle is tested, as in the paper of
``papers_cones.py``. Of some rays and cones of each kind the triangles shown are marked, and every triangle of the scene
is tested against them: one that is met and was not shown stops the program.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators.bvh.bvh import ConeScene as BoxCones
from shadow_tracer.gpu.accelerators.bvh.tree import Tree
from shadow_tracer.gpu.accelerators.cone_kernels import ConesAsked
from shadow_tracer.gpu.accelerators.kd_tree.kd_tree import ConeScene as PlaneCones
from shadow_tracer.gpu.accelerators.kd_tree.splitting import Structure
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.visibility.queries import Query

_HERE = Path(__file__).resolve().parent  # an absolute path is a header's name as well
_CHECKED = 12  # rays or cones of a kind of which all triangles are tested


@wp.struct
class Counted:
    """What is counted: of each ray or cone; the first have a row of marks, one for each triangle of the scene."""

    nodes: wp.array(dtype=int)
    triangles: wp.array(dtype=int)
    marks: wp.array2d(dtype=wp.uint8)


@wp.struct
class RaysAsked:
    """Rays without an end."""

    count: int  # triangles
    apices: wp.array(dtype=wp.vec3d)
    ways: wp.array(dtype=wp.vec4d)  # 0 after a direction
    counted: Counted


def _kernel(call: str, walk: str, scene: Any) -> Any:
    """A kernel of ``papers_cones.h`` for cones through a structure: ``walk`` is its header, ``scene`` what it takes."""
    arguments = {"scene": scene, "asked": ConesAsked, "counted": Counted, "together": int}

    def one(number, scene, asked, counted, together):  # type: ignore[no-untyped-def]
        ...

    name = f"{call}_{Path(walk).parent.name}"
    one.__annotations__, one.__name__, one.__qualname__ = {"number": int, **arguments}, f"one_{name}", f"one_{name}"
    code = f"CountedCones::{call}(number, scene, asked, counted, together);"
    take = wp.func_native(native.snippet(str(_HERE / "papers_cones.h"), call=code, roles={"cone_walk": walk}))(one)

    def cones(scene, asked, counted, together):  # type: ignore[no-untyped-def]
        take(wp.tid(), scene, asked, counted, together)

    cones.__annotations__, cones.__name__, cones.__qualname__ = arguments, f"cones_{name}", f"cones_{name}"
    return wp.kernel(cones, enable_backward=False, module=f"papers_cones.{Path(walk).parent.name}")


_EVERY = Query(str(_HERE / "papers_rays.h"), RaysAsked)


@dataclass(frozen=True)
class _Way:
    """How rays and cones go through a tree: its pipeline, the walk, the kernels; and whether cones look at sixteen
    boxes at a time."""

    pipeline: str
    rays: Walk
    count: Any
    check: Any
    together: int = 0


_BOXES = tuple(_kernel(call, "accelerators/bvh/cone_walk.h", BoxCones) for call in ("count", "check"))
_CELLS = tuple(_kernel(call, "accelerators/kd_tree/cone_walk.h", PlaneCones) for call in ("count", "check"))
TREES = {
    "bvh, 2 children": _Way("bvh", Walk("accelerators/bvh/pairs.h", Tree, queries=(_EVERY,)), *_BOXES),
    "bvh, 16 children": _Way("bvh", Walk("accelerators/bvh/sixteen.h", Tree, queries=(_EVERY,)), *_BOXES, 1),
    "kd_tree": _Way("kd_tree", Walk("accelerators/kd_tree/planes.h", Structure, queries=(_EVERY,)), *_CELLS),
}


@dataclass(frozen=True)
class Spent:
    """Of one ray or cone on average: microseconds of processor time, nodes and triangles; the most triangles of one."""

    microseconds: float
    nodes: float
    triangles: float
    most: int


class Trees:
    """The trees over a mesh.

    Attributes:
        tracer: one that answers questions about cones by ``bvh``.
        build_ms: processor time of making the tree of a pipeline.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        bounds = Bounds(max_triangles=len(triangles), max_rays=1, max_lights=1)
        self._device, self._count = wp.get_device("cpu"), len(triangles)
        self.build_ms: dict[str, float] = {}
        self._scenes: dict[str, Any] = {}
        self._tracers = {
            name: ShadowTracer(name, device="cpu", bounds=bounds, threads=1) for name in ("bvh", "kd_tree")
        }
        self.tracer = self._tracers["bvh"]
        for name, tracer in self._tracers.items():
            tracer.scene.put("mesh", vertices, triangles)
            tracer._engine.ask_cones(tracer.scene, partial(self._make, name))

    def _make(self, name: str, cones: Any) -> None:
        for _ in range(2):  # the first loads kernels
            cones._build.forget()
            begin = time.process_time()
            self._scenes[name] = cones.follow()
            self.build_ms[name] = 1e3 * (time.process_time() - begin)

    def traverse(self, tree: str, apices: np.ndarray, ways: np.ndarray, slope: float, turns: int = 1) -> Spent:
        """Rays, or cones if ``slope``, the tangent of their half angle, is not 0, from (N, 3) ``apices`` in directions
        (N, 3), and the median time of so many turns; some are checked before.

        Raises:
            SystemExit: a triangle that is met was not shown.
        """
        every = max(1, len(apices) // _CHECKED)
        self._check(tree, apices[::every], ways[::every], slope)
        asked, counted, spent = self._asked(apices, ways, slope), self._counted(len(apices), 0), []
        for _ in range(turns):
            begin = time.process_time()
            self._send(tree, asked, counted)
            spent.append(time.process_time() - begin)
        nodes, triangles = counted.nodes.numpy(), counted.triangles.numpy()
        per_one = 1e6 * float(np.median(spent)) / len(apices)
        return Spent(per_one, float(nodes.mean()), float(triangles.mean()), int(triangles.max()))

    def _check(self, tree: str, apices: np.ndarray, ways: np.ndarray, slope: float) -> None:
        asked, counted, way = self._asked(apices, ways, slope), self._counted(len(apices), self._count), TREES[tree]
        self._send(tree, asked, counted)
        inputs = [self._scenes[way.pipeline], asked, counted, 0]
        wp.launch(way.check, dim=len(apices), inputs=inputs, device=self._device)
        missed, met = int(counted.nodes.numpy().sum()), int(counted.triangles.numpy().sum())
        if missed:
            raise SystemExit(f"{tree}: {missed} of {met} triangles that are met were not shown")

    def _send(self, tree: str, asked: ConesAsked, counted: Counted) -> None:
        count, device, way = asked.apices.shape[0], self._device, TREES[tree]
        scene = self._scenes[way.pipeline]
        if asked.slopes.numpy()[0] > 0.0:
            wp.launch(way.count, dim=count, inputs=[scene, asked, counted, way.together], device=device)
            return
        rays = RaysAsked()
        rays.count, rays.apices, rays.ways, rays.counted = self._count, asked.apices, asked.ends, counted
        way.rays.launch(_EVERY, count, scene.tree, rays, device)

    def _asked(self, apices: np.ndarray, ways: np.ndarray, slope: float) -> ConesAsked:
        asked = ConesAsked()
        asked.apices = wp.array(np.ascontiguousarray(apices), dtype=wp.vec3d, device=self._device)
        asked.ends = wp.array(np.insert(ways, 3, 0.0, axis=1), dtype=wp.vec4d, device=self._device)
        asked.slopes = wp.full(len(apices), slope, dtype=wp.float64, device=self._device)
        return asked

    def _counted(self, count: int, marks: int) -> Counted:
        counted = Counted()
        counted.nodes = wp.zeros(count, dtype=int, device=self._device)
        counted.triangles = wp.zeros(count, dtype=int, device=self._device)
        counted.marks = wp.zeros((count if marks else 0, marks), dtype=wp.uint8, device=self._device)
        return counted
