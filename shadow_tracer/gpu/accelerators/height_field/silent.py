# SPDX-License-Identifier: Apache-2.0
"""Triangles that cast nothing for a light, counted without making their records."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.occluders.slots import Range
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.scene.bounds import Bounds

_BLOCK = wp.constant(128)  # triangles a thread
_ROWS = wp.constant(64)


@native.func_native("accelerators/height_field/silent.h", calls="SilentTriangles::count")
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
    count_block(begin, wp.min(begin + _BLOCK, end), light, cull, vertices, triangles, wp.tid() % _ROWS, counts)


class Silent:
    """Counts them."""

    def __init__(self, bounds: Bounds, scene: SceneBuffers) -> None:
        self._scene = scene
        self._counts = wp.zeros(int(_ROWS), dtype=wp.vec2i, device=scene.device)

    def count(self, triangles: Range, light: LightFrame, cull: bool) -> tuple[int, int]:
        """How many of a range of triangles are degenerate, and how many are culled. Waits for the device."""
        scene, (first, end) = self._scene, triangles
        self._counts.zero_()
        inputs = [first, end, light.light, int(cull), scene.vertices, scene.triangles, self._counts]
        wp.launch(count_silent, dim=-(-(end - first) // int(_BLOCK)), inputs=inputs, device=scene.device)
        degenerate, culled = (int(value) for value in self._counts.numpy().sum(axis=0))
        return degenerate, culled

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._counts.capacity)
