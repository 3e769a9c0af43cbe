# SPDX-License-Identifier: Apache-2.0
"""Triangles that cast nothing for a light, counted without making their records: of accelerators that decide in place
(``visibility/in_place.h``)."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.world import SceneBuffers

_BLOCK = wp.constant(128)  # triangles a thread
ROWS = wp.constant(64)
"""Of sums that threads add to in turn."""


@native.func_native("accelerators/silent.h", calls="SilentTriangles::count")
def count_block(
    first: int,
    last: int,
    light: wp.vec4d,
    cull: int,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    row: int,
    counts: wp.array(dtype=wp.vec2i),
):
    """Add to ``counts[row]`` how many of some triangles are degenerate, and culled."""
    ...


@wp.kernel(enable_backward=False)
def count_silent(
    first: int,
    end: int,
    light: wp.vec4d,
    cull: int,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    counts: wp.array(dtype=wp.vec2i),
):
    """A block of triangles per thread."""
    begin = first + wp.tid() * _BLOCK
    count_block(begin, wp.min(begin + _BLOCK, end), light, cull, vertices, triangles, wp.tid() % ROWS, counts)


class SilentCounts:
    """Sums them.

    Attributes:
        counts: sums so far, degenerate ones and those culled, in ``ROWS`` parts.
    """

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        self.counts = wp.zeros(int(ROWS), dtype=wp.vec2i, device=scene.device)

    def begin(self) -> None:
        """From none."""
        self.counts.zero_()

    def add(self, first: int, count: int, light: LightFrame, cull: bool) -> None:
        """Those among some triangles of the scene."""
        scene = self._scene
        inputs = [first, first + count, light.light, int(cull), scene.vertices, scene.triangles, self.counts]
        wp.launch(count_silent, dim=-(-count // int(_BLOCK)), inputs=inputs, device=scene.device)

    def total(self) -> tuple[int, int]:
        """How many triangles are degenerate, and how many are culled. Waits for the device."""
        degenerate, culled = (int(value) for value in self.counts.numpy().sum(axis=0))
        return degenerate, culled

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.counts.capacity)
