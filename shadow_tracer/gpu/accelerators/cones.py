# SPDX-License-Identifier: Apache-2.0
"""Cones through structures over space: what is certain of each, and the triangles nearest to its apex.

After Wiche and Kuri 2020: "Performance Evaluation of Acceleration Structures for Cone-Tracing Traversal". One thread
takes a cone, nearer child first: through the tree of ``bvh/sah`` with two children per node, on the CPU for outcomes
through the one with sixteen, and the sixteen triangles of a block at a time; or through a k-d tree, by the distances of
planes (``kd_tree/kd_tree.py``).

*Boxes* (``half_lines.h``). A box is met if, at some distance t along the axis up to the cone's length, it meets the box
of the disc there: o + t (v + w) >= low and o + t (v - w) <= high on each axis, where w = tan(half angle) sqrt(1 - v^2).
These are six half-lines of t, all linear: no cases, and flat boxes and an apex inside need no care. All is in units of
the scene's extent E. Boxes are padded by 2^-19 (``segment.py``) and rounded outwards, so 27 * 2^-24 are left for the
walk. It works in float64, u = 2^-53: the origin is off by 3 u |o|, v and w by 8 u (1 + tan) t, t by 3 u relative, which
moves a point by 3 u (|o| + 2); with |o| <= 2^20 = ``FAR_AWAY`` and tan <= 15 that is below 2^-24 together. A cone from
farther away is shown every triangle. Slopes below 1e-20 are taken as that, which moves points by less than 1e-13.

*Sixteen at a time* (``cone_block.h``). That is in float32, u = 2^-24 from here on, for apices with |o| <= 2 along each
axis. The origin is off by 2 u, the difference to a bound by 3 u, and t by 4 u relative, which moves a point by 12 u:
less than 27 u together. Slopes are off by 2 u (1 + tan), and ``ADDED`` to them are 16 u (1 + tan).

Of a triangle a, a + e, a + f, seen from the apex, e and f are rounded once, a is off by 3.5 u along each axis, the
others by 6.5 u, the unit v along the axis by u. |x| is a sum of magnitudes, S the largest of |e|, |f| and |f - e|.
``ROUGH`` is 128 u, and all pads are made larger by 1e-15 where something might underflow. A triangle is left out by

- *its middle*: with s the sum of the corners and n = s - v (v . s), G(x) = n . x - tan |n| v . x is linear. As rounded
  it is at most 30 u (1 + tan) |s| |x| in the cone: n is off by 20 u |s|, v by u, tan by u. G at a corner is right to
  within (1 + tan) |s| (14 u + 10 u |x|). The pad, 128 u (1 + tan) |s| (1/4 + the corners' sizes), is more than both;
- *the ends*: v . x is off by 14 u + 6 u |x| <= 68 u, and ``longest`` is 32 u longer than the axis;
- *its plane* N . x = N . a, N = e x f. Let g be the products in N without signs, so that N is off by 4 u g and N . a by
  3.5 u |g| + 7 u g . (|a1|, |a2|, |a3|): the pad has 8 and 16. A point t (v + w) of the cone has N . x <= t (N . v +
  tan |N'|), N' being N across v; as rounded that is off by 32 u (1 + tan) |g| t. What of the cone is farther along than
  all corners is not asked for;
- *a plane* through the apex and an edge, if N . a is certainly not 0, so that the triangle's other corner is certainly
  on one side of each. Those of two edges are a x e and f x a, off by 7 u S + 5 u |a| S, the third is N less both, off
  by u S (14 + 16 |a| + 7 S); the product with v by u S (14 + 24 |a| + 11 S), the size across v by twice that. The pad,
  128 u (1 + tan) S (1/4 + 0.4 |a| + 0.2 S), is more than both. The axis does not meet a triangle if it is outside of
  one of these, which the same pad decides, and not all of a cone is hidden by it if not all of it is inside.

*Nearest triangles.* What is inside the cone by roundings of the triangle's test may be outside by some 1e-8 of its
distance (a square root of roundings, where an edge touches the cone), so ``ADDED`` is added to the slopes of the
half-lines. Moreover a triangle counts if its own box is met as well, and its distance is moved into what the half-lines
say of that box. All boxes around it hold it, and each operation of the half-lines is monotone: so they say that they
are met, no later, and to no less far. A node that is left out holds no triangle that counts and is before the last one
found, or behind the one after which is asked, whatever has been rounded: lists do not depend on the tree.

Outcomes are in ``cone_outcome.h``, docs/exactness.md proves them. Once a triangle has met the cone, it is not free any
more, and what hides all of it is on its axis: the walk goes on along that alone. What has hidden a cone is asked about
first for the next ones (``hints``): what they say is so of a triangle and what goes on from it, whoever names it, and
the walk would come to one of these. With a budget it might not, so there are no hints then.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.accelerators.cone_kernels import FREE, NO_BUDGET, OF_A_HINT, ConesAsked
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
# Cones that a thread takes at a time; hints are of fewer, so that threads have none in common.
SOME = 8 * OF_A_HINT


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
        asked.hints = wp.empty(-(-PIECE // OF_A_HINT), dtype=int, device=device)
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
            asked.hints.fill_(-1)
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
        arrays = (asked.apices, asked.ends, asked.slopes, asked.outcomes, asked.hints, asked.after, asked.after_numbers)
        own = sum(int(array.capacity) for array in (*arrays, asked.distances, asked.numbers))
        return own + self._neighbours.nbytes()
