# SPDX-License-Identifier: Apache-2.0
"""What Warp brings for shadow rays, on any device: wp.Mesh built anew or refitted, and a wp.Bvh rebuilt in place whose
boxes a kernel of ours walks. On CUDA all of them are linear BVHs. Rays lie on the device before the clock starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from case import Case
from rivals import any_hit


@wp.kernel(enable_backward=False)
def bound_triangles(
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    a = points[indices[3 * i]]
    b = points[indices[3 * i + 1]]
    c = points[indices[3 * i + 2]]
    lowers[i] = wp.min(wp.min(a, b), c)
    uppers[i] = wp.max(wp.max(a, b), c)


@wp.kernel(enable_backward=False)
def any_hit_of_boxes(
    bvh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    starts: wp.array(dtype=wp.vec3),
    ways: wp.array(dtype=wp.vec3),
    reach: wp.array(dtype=float),
    out: wp.array(dtype=wp.uint8),
):
    """Moeller and Trumbore's test, both sides, on every triangle whose box the ray meets, until one is hit."""
    i = wp.tid()
    start = starts[i]
    way = ways[i]
    far = reach[i]
    hit = wp.uint8(0)
    query = wp.bvh_query_ray(bvh, start, way)
    k = int(0)
    while hit == wp.uint8(0) and wp.bvh_query_next(query, k, far):
        a = points[indices[3 * k]]
        ab = points[indices[3 * k + 1]] - a
        ac = points[indices[3 * k + 2]] - a
        p = wp.cross(way, ac)
        determinant = wp.dot(ab, p)
        if determinant != 0.0:
            to_start = start - a
            q = wp.cross(to_start, ab)
            u = wp.dot(to_start, p) / determinant
            v = wp.dot(way, q) / determinant
            t = wp.dot(ac, q) / determinant
            if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t >= 0.0 and t <= far:
                hit = wp.uint8(1)
    out[i] = hit


class Peer:
    """A structure and a query.

    Attributes:
        name: its row in tables.
        recordable: whether ``structure`` and ``query`` may be captured on CUDA.
    """

    name = ""
    recordable = True

    def __init__(self, case: Case, device: Any) -> None:
        self.device = device
        # On the CPU there is no LBVH; Warp's default is what people get.
        self.constructor = "lbvh" if device.is_cuda else "sah"
        self._positions = [np.ascontiguousarray(p, np.float32) for p in case.view.positions]
        self.points = wp.array(self._positions[0], dtype=wp.vec3, device=device)
        self.indices = wp.array(case.view.triangles.ravel(), dtype=int, device=device)
        rays = [frame.lights[0] for frame in case.frames]
        self._rays = [
            [wp.array(getattr(each, what), dtype=kind, device=device) for what, kind in _KINDS] for each in rays
        ]
        most = max(len(each.starts) for each in rays)
        self.counts = [len(each.starts) for each in rays]
        # What the query reads: fixed addresses, so that a recording serves all frames.
        self.rays = [wp.zeros(most, dtype=kind, device=device) for _, kind in _KINDS]
        self.out = wp.zeros(most, dtype=wp.uint8, device=device)

    def take_rays(self, frame: int) -> None:
        """Make the rays of a frame the ones that are queried: from device to device, not timed."""
        self.rays[2].fill_(-1.0)  # nothing is within a negative length
        for target, source in zip(self.rays, self._rays[frame], strict=True):
            wp.copy(target, source)

    def upload(self, frame: int) -> None:
        """The positions of a frame onto the device."""
        wp.copy(self.points, wp.array(self._positions[frame], dtype=wp.vec3, device="cpu", copy=False))

    def structure(self) -> None:
        """Build or refit over ``points``."""
        raise NotImplementedError

    def query(self) -> None:
        """Fill ``out``."""
        raise NotImplementedError

    def answer(self, frame: int) -> np.ndarray:
        """(N,) bool: occluded. Waits for the device."""
        found: np.ndarray = self.out.numpy()[: self.counts[frame]].view(np.bool_)
        return found


_KINDS = (("starts", wp.vec3), ("ways", wp.vec3), ("reach", float))


class MeshBuild(Peer):
    """wp.Mesh made anew: it cannot be rebuilt in place."""

    name = "wp.Mesh build + any-hit"
    recordable = False

    def structure(self) -> None:
        self._mesh = wp.Mesh(self.points, self.indices, bvh_constructor=self.constructor)

    def query(self) -> None:
        wp.launch(any_hit, dim=len(self.out), inputs=[self._mesh.id, *self.rays, self.out], device=self.device)


class MeshRefit(MeshBuild):
    """wp.Mesh with the boxes of its first frame's tree made anew."""

    name = "wp.Mesh refit + any-hit"
    recordable = True

    def __init__(self, case: Case, device: Any) -> None:
        super().__init__(case, device)
        super().structure()

    def structure(self) -> None:
        self._mesh.refit()


class BvhRebuild(Peer):
    """wp.Bvh rebuilt in place."""

    name = "wp.Bvh rebuild + any-hit"

    def __init__(self, case: Case, device: Any) -> None:
        super().__init__(case, device)
        count = len(case.view.triangles)
        self._boxes = [wp.empty(count, dtype=wp.vec3, device=device) for _ in range(2)]
        self._bound()
        self._bvh = wp.Bvh(*self._boxes, constructor=self.constructor)

    def _bound(self) -> None:
        inputs = [self.points, self.indices, *self._boxes]
        wp.launch(bound_triangles, dim=len(self._boxes[0]), inputs=inputs, device=self.device)

    def structure(self) -> None:
        self._bound()
        self._bvh.rebuild()

    def query(self) -> None:
        inputs = [self._bvh.id, self.points, self.indices, *self.rays, self.out]
        wp.launch(any_hit_of_boxes, dim=len(self.out), inputs=inputs, device=self.device)


PEERS: dict[str, Callable[[Case, Any], Peer]] = {each.name: each for each in (MeshBuild, MeshRefit, BvhRebuild)}
