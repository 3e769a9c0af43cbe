# SPDX-License-Identifier: Apache-2.0
"""Cones through the tree of ``bvh/sah``: what is certain of each, and the triangles nearest to its apex.

After Wiche and Kuri 2020: "Performance Evaluation of Acceleration Structures for Cone-Tracing Traversal". One thread
takes a cone, through the tree with two children per node, nearer child first; on the CPU outcomes go through the tree
with sixteen, and test the sixteen triangles of a block at a time.

*Boxes.* A box is met if, at some distance t along the axis up to the cone's length, it meets the box of the disc there:
o + t (v + w) >= low and o + t (v - w) <= high on each axis, where w = tan(half angle) sqrt(1 - v^2). These are six
half-lines of t, all linear: no cases, and flat boxes and an apex inside need no care. All is in units of the scene's
extent E. Boxes are padded by 2^-19 (``segment.py``) and rounded outwards, so 27 * 2^-24 are left for the walk. It works
in float64, u = 2^-53: the origin is off by 3 u |o|, v and w by 8 u (1 + tan) t, t by 3 u relative, which moves a point
by 3 u (|o| + 2); with |o| <= 2^20 = ``FAR_AWAY`` and tan <= 15 that is below 2^-24 together. A cone from farther away
is shown every triangle. Slopes below 1e-20 are taken as that, which moves points by less than 1e-13.

*Sixteen at a time.* That is in float32, u = 2^-24 from here on, for apices with |o| <= 2. The origin is off by 2 u, the
difference to a bound by 3 u, and t by 4 u relative, which moves a point by 12 u: less than 27 u together. Slopes are
off by 2 u (1 + tan), and ``ADDED`` to them are 16 u (1 + tan). A block's triangle is left out where ``Cone.far_off``
says so with a rougher band: with s the sum of the corners from the apex and n = s - v (v . s), G(x) = n . x - tan |n| v
. x is linear. As rounded it is at most 30 u (1 + tan) |s| |x| in the cone: n is off by 20 u |s|, v by u, tan by u. A
corner is within 14 u of the real one, so G there is right to within (1 + tan) |s| (14 u + 10 u |x|). ``ROUGH`` = 128 u,
times (1 + tan) |s| (1/4 + the sum of the corners' sizes), is more than both, sizes being sums of absolute values.

*Nearest triangles.* What is inside the cone by roundings of the triangle's test may be outside by some 1e-8 of its
distance (a square root of roundings, where an edge touches the cone), so ``ADDED`` is added to the slopes of the
half-lines. Moreover a triangle counts if its own box is met as well, and its distance is moved into what the half-lines
say of that box. All boxes around it hold it, and each operation of the half-lines is monotone: so they say that they
are met, no later, and to no less far. A node that is left out holds no triangle that counts and is before the last one
found, or behind the one after which is asked, whatever has been rounded: lists do not depend on the tree.

Outcomes are in ``cone_outcome.h``, docs/exactness.md proves them.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.accelerators.bvh.bvh import ConeScene as ConeScene
from shadow_tracer.gpu.accelerators.cone_kernels import FREE, ConesAsked
from shadow_tracer.gpu.accelerators.walker import Build
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.device.transfers import Uploads
from shadow_tracer.gpu.device.workers import Workers
from shadow_tracer.gpu.occluders.neighbours import Neighbours
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.checks import FloatArray

# Cones asked about at once, and places of their lists.
PIECE, PLACES = 1 << 16, 1 << 19
# Cones that a thread takes at a time.
SOME = 512
NO_BUDGET = 2**31 - 1


class Cones:
    """Answers questions about cones over a scene.

    Args:
        scene: the world, whose ``bounds`` say how much there may be.
        build: what cones go through.
        threads: how many cores of the CPU they may keep busy.
    """

    def __init__(self, scene: SceneBuffers, build: Build, threads: int) -> None:
        assert build.cones is not None
        self._scene, device = scene, scene.device
        self._workers = Workers(threads if forms.wide(device) else 1)
        self._build, self._kernels = build, build.cones
        self._neighbours = Neighbours(scene)
        self._stages, self._upload = Stages(device), Uploads(device)
        asked = self._asked = ConesAsked()
        asked.apices = wp.empty(PIECE, dtype=wp.vec3d, device=device)
        asked.ends = wp.empty(PIECE, dtype=wp.vec4d, device=device)
        asked.slopes = wp.empty(PIECE, dtype=wp.float64, device=device)
        asked.outcomes = wp.empty(PIECE, dtype=wp.uint8, device=device)
        asked.after = wp.empty(PIECE, dtype=wp.float64, device=device)
        asked.after_numbers = wp.empty(PIECE, dtype=int, device=device)
        asked.distances = wp.empty(PLACES, dtype=wp.float64, device=device)
        asked.numbers = wp.empty(PLACES, dtype=int, device=device)

    def follow(self) -> Any:
        """What cones go through, of the scene as it is, which has triangles."""
        scene, made = self._scene, self._kernels.scene()
        made.tree, made.count = self._build.for_cones(self._stages), scene.triangle_count
        self._neighbours.follow()
        made.vertices, made.triangles = scene.vertices, scene.triangles
        made.neighbours, made.numbers = self._neighbours.across, self._neighbours.numbers
        return made

    def outcomes(
        self, apices: FloatArray, ends: FloatArray, slopes: FloatArray, budget: int | None
    ) -> npt.NDArray[np.uint8]:
        """(N,) FREE, PARTLY or BLOCKED for cones with apices (N, 3), ends (N, 4), as ``ConesAsked`` has them, and
        tangents of half angles (N,)."""
        found = np.full(len(apices), FREE, np.uint8)
        if not self._scene.triangle_count:
            return found
        scene, asked = self.follow(), self._asked
        asked.budget = NO_BUDGET if budget is None else min(budget, NO_BUDGET)
        for first in range(0, len(apices), PIECE):
            piece = slice(first, min(first + PIECE, len(apices)))
            count = self._put(apices[piece], ends[piece], slopes[piece])
            self._send(self._kernels.find_outcomes, count, scene)
            found[piece] = asked.outcomes[:count].numpy()
        self._build.cones_asked()
        return found

    def hits(
        self,
        apices: FloatArray,
        ends: FloatArray,
        slopes: FloatArray,
        most: int,
        after: tuple[FloatArray, npt.NDArray[np.integer[Any]]] | None,
    ) -> tuple[npt.NDArray[np.int32], FloatArray]:
        """(N, most) numbers of triangles, -1 where there are no more, and their distances [m], infinite there.

        ``ends``: as above; ``after``: distance and number of each cone's last that is not
        asked for.
        """
        numbers = np.full((len(apices), most), -1, np.int32)
        distances = np.full((len(apices), most), np.inf)
        if not self._scene.triangle_count:
            return numbers, distances
        scene, asked, together = self.follow(), self._asked, min(PIECE, PLACES // most)
        asked.most = most
        for first in range(0, len(apices), together):
            piece = slice(first, min(first + together, len(apices)))
            count = self._put(apices[piece], ends[piece], slopes[piece])
            last = (np.full(count, -1.0), np.full(count, -1)) if after is None else (after[0][piece], after[1][piece])
            self._upload(asked.after, np.ascontiguousarray(last[0], np.float64))
            self._upload(asked.after_numbers, np.ascontiguousarray(last[1], np.int32))
            self._send(self._kernels.find_hits, count, scene)
            numbers[piece] = asked.numbers[: count * most].numpy().reshape(count, most)
            distances[piece] = asked.distances[: count * most].numpy().reshape(count, most)
        self._build.cones_asked()
        return numbers, distances

    def _put(self, apices: FloatArray, ends: FloatArray, slopes: FloatArray) -> int:
        self._upload(self._asked.apices, np.ascontiguousarray(apices))
        self._upload(self._asked.ends, np.ascontiguousarray(ends))
        self._upload(self._asked.slopes, np.ascontiguousarray(slopes))
        return len(apices)

    def _send(self, kernel: Any, count: int, scene: Any) -> None:
        """``count`` cones through the scene, some at a time: whoever is done takes the next."""
        device, asked = self._scene.device, self._asked
        threads = min(self._workers.count, -(-count // SOME))
        if threads < 2:
            wp.launch(kernel, dim=count, inputs=[0, scene, asked], device=device)
            return
        wp.load_module(kernel.module, device, max_workers=0)  # several threads must not be the first to launch it
        left = deque(range(0, count, SOME))

        def job() -> None:
            while left:
                try:
                    first = left.popleft()
                except IndexError:  # another thread has taken the last
                    return
                wp.launch(kernel, dim=min(SOME, count - first), inputs=[first, scene, asked], device=device)

        self._workers.run([job] * threads)

    def nbytes(self) -> int:
        """Bytes on the device beside the tree."""
        asked = self._asked
        arrays = (asked.apices, asked.ends, asked.slopes, asked.outcomes, asked.after, asked.after_numbers)
        own = sum(int(array.capacity) for array in (*arrays, asked.distances, asked.numbers))
        return own + self._neighbours.nbytes()
