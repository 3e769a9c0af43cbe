# SPDX-License-Identifier: Apache-2.0
"""What a frame costs with a pipeline that ``auto`` may choose: by a rough law before it is traced, and by what has been
counted afterwards. Milliseconds of one core, and never of a clock: another program on the machine would be in them, and
the same frames would be traced by other pipelines from one run to the next.

Fitted to 328 kinds of frames, 36 to 331,179 triangles, 1,024 to 262,144 pixels, meshes moving or at rest, on a core
with AVX-512 (docs/performance.md, "The automatic choice"). No Warp here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

Names = tuple[str, str]

LIGHT_GRID: Names = ("light_grid", "packed")
MESH_BVH: Names = ("mesh_bvh", "refit")
BRUTE_FORCE: Names = ("brute_force", "filtered")

# Nanoseconds: of a frame, a sample, a triangle that has moved, of a scene of other triangles, and of one thing that is
# counted. A node of ``mesh_bvh`` takes more for each doubling of the triangles beyond 8,192: they leave the caches.
_GRID_FRAME, _GRID_RAY, _GRID_MOVED, _GRID_BOX, _GRID_ENTRY = 370_000.0, 14.0, 8.0, 2.2, 32.0
_TREE_FRAME, _TREE_RAY, _TREE_MOVED, _TREE_BUILT = 520_000.0, 35.0, 80.0, 350.0
_TREE_NODE, _TREE_FAR, _TREE_NEAR, _TREE_TEST = 14.0, 1.2, 13.0, 4.5
_BRUTE_FRAME, _BRUTE_RAY, _BRUTE_MOVED, _BRUTE_TEST = 480_000.0, 10.0, 100.0, 0.45
# Points are sorted, or find nothing of a tree in the caches that the one before has left there.
_GRID_LISTED, _TREE_LISTED = 30.0, 2.5
# The same before anything has been counted: of a pair of sample and triangle its root, and what a ray takes of a tree.
_GRID_PAIR, _GRID_TRIANGLE, _TREE_STEP, _BRUTE_PAIR = 55.0, 12.0, 11.0, 0.3


@dataclass(frozen=True)
class Situation:
    """What the cost of a frame depends on.

    Attributes:
        change: 0 nothing, 1 positions, 2 triangles of the scene have changed since the frame before.
        rays, triangles, lights: their numbers.
        new_lights: whether lights or their frame have changed.
        listed: whether samples are a list of points, in any order, and no image.
    """

    change: int
    rays: int
    triangles: int
    lights: int
    new_lights: bool = False
    listed: bool = False

    @cached_property
    def kind(self) -> tuple[int, ...]:
        """Situations that are taken for the same."""
        sizes = (self.rays, self.triangles, self.lights)
        return (self.change, *(max(size, 1).bit_length() for size in sizes), int(self.new_lights), int(self.listed))


def lawful(names: Names, frame: Situation) -> float:
    """Milliseconds by the rough law."""
    n, t, lights = frame.rays, max(frame.triangles, 1), frame.lights
    if names == LIGHT_GRID:
        ray = _GRID_RAY + _GRID_LISTED * frame.listed
        cost = lights * (ray * n + _GRID_PAIR * math.sqrt(n * t) + _GRID_TRIANGLE * t)
    elif names == MESH_BVH:
        cost = lights * _TREE_STEP * n * math.log2(t + 1) * (_TREE_LISTED if frame.listed else 1.0)
    else:
        cost = lights * (_BRUTE_PAIR * n * t + _BRUTE_RAY * n)
    return (cost + _whatever_is_found(names, frame)) * 1e-6


def counted(names: Names, frame: Situation, counters: Mapping[str, int]) -> float:
    """Milliseconds by what a frame has counted, of all its lights."""
    n, nodes, tests = frame.rays * frame.lights, counters["nodes_visited"], counters["leaf_tests"]
    if names == LIGHT_GRID:
        ray = _GRID_RAY + _GRID_LISTED * frame.listed
        cost = ray * n + _GRID_BOX * nodes + _GRID_ENTRY * counters["entries"]
    elif names == MESH_BVH:
        far = max(math.log2(max(frame.triangles, 1)) - _TREE_NEAR, 0.0)
        walk = (_TREE_NODE + _TREE_FAR * far) * nodes + _TREE_TEST * tests
        cost = _TREE_RAY * n + walk * (_TREE_LISTED if frame.listed else 1.0)
    else:
        cost = _BRUTE_RAY * n + _BRUTE_TEST * tests
    return (cost + _whatever_is_found(names, frame)) * 1e-6


def catching_up(names: Names, frame: Situation) -> float:
    """Milliseconds to make what a candidate has not made yet of a scene that rests."""
    return _TREE_BUILT * frame.triangles * 1e-6 if names == MESH_BVH else 0.0


def _whatever_is_found(names: Names, frame: Situation) -> float:
    """Nanoseconds of a frame, and of what is made of its triangles if these are new."""
    if names == LIGHT_GRID:
        return _GRID_FRAME + (_GRID_MOVED if frame.change else 0.0) * frame.triangles
    if names == MESH_BVH:
        return _TREE_FRAME + (0.0, _TREE_MOVED, _TREE_BUILT)[frame.change] * frame.triangles
    return _BRUTE_FRAME + (_BRUTE_MOVED if frame.change else 0.0) * frame.triangles
