# SPDX-License-Identifier: Apache-2.0
"""Trees over space as tests look at them: nodes of a tracer's structure, the boxes of its leaves, and their triangles;
and scenes for structures over space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import geometry
import numpy as np
import probe

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators.segment import scene_box

BOUNDS = {"max_triangles": 5000, "max_rays": 20_000, "max_lights": 2}
LEAF = 3


def tracer_of(device: str, pipeline: str, **more: int) -> ShadowTracer:
    """A fresh one."""
    return ShadowTracer(pipeline, device=device, bounds=Bounds(**{**BOUNDS, **more}), threads=1)


def hidden(tracer: ShadowTracer, mesh: geometry.Geometry, points: np.ndarray, light: Any) -> np.ndarray:
    """Which points the mesh hides from the light."""
    tracer.scene.put("mesh", *mesh)
    return tracer.occluded(points, light)


def mesh_of(corners: np.ndarray) -> geometry.Geometry:
    """(T, 3, 3) triangles that share nothing."""
    return corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)


def equal(tracer: ShadowTracer, mesh: geometry.Geometry, points: np.ndarray, light: Any) -> np.ndarray:
    """Which points both the tracer and every triangle hide."""
    expected = hidden(tracer_of(tracer.device, "brute_force"), mesh, points, light)
    found = hidden(tracer, mesh, points, light)
    assert np.array_equal(found, expected), (found != expected).sum()
    return expected


_UNLIKE = ["clusters ball", "ball", "", "soup", "soup clusters ball", "clusters ball", "soup ball", "soup"]
_UNLIKE += ["clusters", "dot", "soup clusters", "soup clusters", "clusters"]


def unlike_scenes(
    rng: np.random.Generator, tracers: Sequence[ShadowTracer], number: int = 2500
) -> Iterator[tuple[int, int]]:
    """Large and small scenes, none, and such with gaps where parts have gone, put into tracers in turn: the number of
    each, and of its triangles. ``number``: of triangles of the largest part."""
    ball, soup = geometry.icosphere(3, 0.3, (0.2, 0.1, 0.0)), geometry.soup(rng, 300, 0.3, 2.0)
    made = {"clusters": mesh_of(clusters(rng, number)), "ball": ball, "soup": soup, "dot": (ball[0] * 1e-3, ball[1])}
    for frame, names in enumerate(_UNLIKE):
        for tracer in tracers:
            for name, mesh in made.items():
                if name in names.split():
                    tracer.scene.put(name, *mesh)
                elif name in tracer.scene:
                    tracer.scene.remove(name)
        yield frame, sum(len(made[name][1]) for name in names.split())


class Tree:
    """The tree of a tracer, in the scene's coordinates; of a ``bsp``, all leaves have the box of the scene.

    Attributes:
        leaves: numbers of nodes.
        boxes: (leaves, 2, 3) low and high corners.
        inner: how many nodes have children.
    """

    def __init__(self, tracer: ShadowTracer) -> None:
        made = probe.structure(tracer)
        self._nodes, self._members = made.nodes.numpy(), made.members.numpy()
        assert self._nodes.dtype.itemsize * self._nodes.shape[1] == 8, "bytes of a node"
        self._planes = self._nodes[:, 0].copy().view(np.float32)
        self._eight = tracer.pipeline == "octree"
        self.inner, self.depth = 0, 0
        self.leaves: list[int] = []
        boxes: list[np.ndarray] = []
        box = made.box if tracer.pipeline != "bsp" else scene_box(-np.ones(3), np.ones(3))
        self._cut = tracer.pipeline != "bsp"
        half = np.full(3, 129 / 128) if self._eight else np.array(box.half, np.float32).astype(float)
        waiting = [(0, np.array([-half, half]), 0)]
        while waiting:
            number, cell, depth = waiting.pop()
            children = self._children(number, cell)
            self.depth = max(self.depth, depth)
            if children:
                self.inner += 1
                waiting += [(child, part, depth + 1) for child, part in children]
            else:
                self.leaves.append(number)
                boxes.append(cell)
        self.boxes = np.array(boxes) / box.inverse_extent + np.array(box.center)

    def _children(self, number: int, box: np.ndarray) -> list[tuple[int, np.ndarray]]:
        kind, first = self._nodes[number, 1] & 3, self._nodes[number, 1] >> 2
        if kind == LEAF:
            return []
        found = []
        for k in range(8 if self._eight else 2):
            part = box.copy()
            for axis in range(3) if self._eight else (kind,) if self._cut else ():
                middle = 0.5 * (box[0, axis] + box[1, axis]) if self._eight else float(self._planes[number])
                part[1 - (k >> (axis if self._eight else 0) & 1), axis] = middle
            found.append((first + k, part))
        return found

    def triangles(self, leaf: int) -> list[int]:
        """Of a leaf."""
        first, count = self._nodes[leaf, 0], self._nodes[leaf, 1] >> 2
        return list(self._members[first : first + count].tolist())

    def held(self) -> np.ndarray:
        """All members of all leaves."""
        return np.array([triangle for leaf in self.leaves for triangle in self.triangles(leaf)], int)

    def corners(self) -> np.ndarray:
        """(N, 3) of leaves."""
        low, high = self.boxes[:, 0], self.boxes[:, 1]
        return np.concatenate([np.where([k >> axis & 1 for axis in range(3)], low, high) for k in range(8)])


def clusters(rng: np.random.Generator, number: int = 2000) -> np.ndarray:
    """(number, 3, 3): small triangles, dense around some points and denser there around others; the first ones keep
    the box of the scene."""
    centres = rng.uniform(-0.8, 0.8, (6, 3))
    which = rng.integers(0, 6, number)
    reach = np.where(rng.random(number) < 0.5, 0.004, 0.08)
    middle = centres[which] + reach[:, None] * rng.uniform(-1, 1, (number, 3))
    made: np.ndarray = middle[:, None] + 0.1 * reach[:, None, None] * rng.uniform(-1, 1, (number, 3, 3))
    made[0] = [(-1, -1, -1), (-1, -0.99, -1), (-0.99, -1, -1)]
    made[1] = [(1, 1, 1), (1, 0.99, 1), (0.99, 1, 1)]
    return made
