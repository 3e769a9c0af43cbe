# SPDX-License-Identifier: Apache-2.0
"""Whole traversals of rays and cones through the project's trees: nodes, triangles and time of each.

Nothing ends a traversal but the end of the ray or cone, and no triangle is tested, as in the paper of
``papers_cones.py``. Of some rays and cones of each kind the triangles shown are marked, and every triangle of the scene
is tested against them: one that is met and was not shown stops the program.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators.bvh.bvh import ConeScene
from shadow_tracer.gpu.accelerators.bvh.tree import Tree
from shadow_tracer.gpu.accelerators.cone_kernels import ConesAsked
from shadow_tracer.gpu.accelerators.cones import Cones
from shadow_tracer.gpu.accelerators.kd_tree.kd_tree import KdTree
from shadow_tracer.gpu.accelerators.kd_tree.splitting import Structure
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.visibility.queries import Query

_HERE = Path(__file__).parent
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


@native.func_native(str(_HERE / "papers_cones.h"), calls="CountedCones::count")
def count_cone(number: int, scene: ConeScene, asked: ConesAsked, counted: Counted, together: int): ...


@native.func_native(str(_HERE / "papers_cones.h"), calls="CountedCones::check")
def check_cone(number: int, scene: ConeScene, asked: ConesAsked, counted: Counted): ...


@wp.kernel(enable_backward=False)
def count_cones(scene: ConeScene, asked: ConesAsked, counted: Counted, together: int):
    count_cone(wp.tid(), scene, asked, counted, together)


@wp.kernel(enable_backward=False)
def check_cones(scene: ConeScene, asked: ConesAsked, counted: Counted):
    check_cone(wp.tid(), scene, asked, counted)


_EVERY = Query(str(_HERE / "papers_rays.h"), RaysAsked)
_PAIRS = Walk("accelerators/bvh/pairs.h", Tree, queries=(_EVERY,))
_SIXTEEN = Walk("accelerators/bvh/sixteen.h", Tree, queries=(_EVERY,))
_PLANES = Walk("accelerators/kd_tree/planes.h", Structure, queries=(_EVERY,))
# Trees, and whether cones can go through them.
TREES = {"bvh, 2 children": True, "bvh, 16 children": True, "kd_tree": False}


@dataclass(frozen=True)
class Spent:
    """Of one ray or cone on average: microseconds of processor time, nodes and triangles; the most triangles of one."""

    microseconds: float
    nodes: float
    triangles: float
    most: int


class Trees:
    """The trees over a mesh."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        bounds = Bounds(max_triangles=len(triangles), max_rays=1, max_lights=1)
        self.tracer = ShadowTracer("bvh", device="cpu", bounds=bounds, threads=1)
        self.tracer.scene.put("mesh", vertices, triangles)
        self._device = wp.get_device("cpu")
        self.build_ms: dict[str, float] = {}
        self.tracer._engine.ask_cones(self.tracer.scene, self._make)

    def _make(self, cones: Cones) -> None:
        stages = Stages(self._device)
        self._cones = self._timed("bvh", cones.follow)
        buffers = cones._scene
        self._count = buffers.triangle_count
        self._kd_tree = KdTree("sah", buffers)
        for _ in range(2):  # the first loads kernels
            self._kd_tree.forget()
            self._timed("kd_tree", lambda: self._kd_tree.follow(stages))
            cones._build.forget()
            self._timed("bvh", cones.follow)

    def _timed(self, tree: str, call: Any) -> Any:
        begin = time.process_time()
        made = call()
        self.build_ms[tree] = 1e3 * (time.process_time() - begin)
        return made

    def traverse(self, tree: str, apices: np.ndarray, ways: np.ndarray, slope: float) -> Spent:
        """Rays, or cones if ``slope``, the tangent of their half angle, is not 0, from (N, 3) ``apices`` in directions
        (N, 3); the first few are checked.

        Raises:
            SystemExit: a triangle that is met was not shown.
        """
        self._check(tree, apices[:: max(1, len(apices) // _CHECKED)], ways[:: max(1, len(ways) // _CHECKED)], slope)
        counted = self._counted(len(apices), 0)
        begin = time.process_time()
        self._send(tree, self._asked(apices, ways, slope), counted)
        spent = time.process_time() - begin
        nodes, triangles = counted.nodes.numpy(), counted.triangles.numpy()
        return Spent(1e6 * spent / len(apices), float(nodes.mean()), float(triangles.mean()), int(triangles.max()))

    def _check(self, tree: str, apices: np.ndarray, ways: np.ndarray, slope: float) -> None:
        asked, counted = self._asked(apices, ways, slope), self._counted(len(apices), self._count)
        self._send(tree, asked, counted)
        wp.launch(check_cones, dim=len(apices), inputs=[self._cones, asked, counted], device=self._device)
        missed = int(counted.nodes.numpy().sum())
        if missed:
            raise SystemExit(
                f"{tree}: {missed} of {counted.triangles.numpy().sum()} triangles that are met were not shown"
            )

    def _send(self, tree: str, asked: ConesAsked, counted: Counted) -> None:
        count, device = asked.apices.shape[0], self._device
        if asked.slopes.numpy()[0] > 0.0:
            together = int(tree == "bvh, 16 children")
            wp.launch(count_cones, dim=count, inputs=[self._cones, asked, counted, together], device=device)
            return
        rays = RaysAsked()
        rays.count, rays.apices, rays.ways, rays.counted = self._count, asked.apices, asked.ends, counted
        if tree == "kd_tree":
            _PLANES.launch(_EVERY, count, self._kd_tree.structure, rays, device)
        else:
            walk = _SIXTEEN if tree == "bvh, 16 children" else _PAIRS
            walk.launch(_EVERY, count, self._cones.tree, rays, device)

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
