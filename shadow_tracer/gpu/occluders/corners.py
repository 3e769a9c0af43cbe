# SPDX-License-Identifier: Apache-2.0
"""The scene's vertices in light space, for tests that need corners and not only planes."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.seen import TriangleRecords

# Vertices per thread on the CPU.
_BLOCK = 256


@native.func_native("occluders/corners.h", calls="Corners::block")
def project_block(
    frame: LightFrame, first: int, last: int, vertices: wp.array(dtype=wp.vec3d), out: wp.array(dtype=wp.vec4)
):
    """(U, V, W, Z) of the vertices from ``first`` to ``last``: each within 2^-24 relative and 2^-46 (1 + its distance
    from the anchor) of exact."""
    ...


@wp.kernel(enable_backward=False)
def project_vertices(
    light: wp.array(dtype=LightFrame), vertices: wp.array(dtype=wp.vec3d), out: wp.array(dtype=wp.vec4)
):
    """One vertex per thread."""
    i = wp.tid()
    project_block(light[0], i, i + 1, vertices, out)


@wp.kernel(enable_backward=False)
def project_vertex_blocks(
    light: wp.array(dtype=LightFrame), count: int, vertices: wp.array(dtype=wp.vec3d), out: wp.array(dtype=wp.vec4)
):
    first = wp.tid() * _BLOCK
    project_block(light[0], first, wp.min(first + _BLOCK, count), vertices, out)


class Corners:
    """(U, V, W, Z) of the scene's vertices for as many lights as there are triangle records of."""

    def __init__(self, records: TriangleRecords) -> None:
        self._records, self._scene = records, records.scene
        capacity = 3 * records.bounds.max_triangles
        self._vertices = wp.empty(capacity, dtype=wp.vec4, device=self._scene.device)
        self._slices = Slices()

    def of(self, light: int, lights: int = 1) -> wp.array:
        """Vertices for ``lights`` lights from number ``light`` on, light after light."""
        count = self._scene.vertex_count
        return self._slices(self._vertices, self._records.place(light) * count, lights * count)

    def make(self, frame: LightFrame) -> None:
        """Make them for the light of ``frame``; to be done whenever its triangle records are made."""
        scene, light = self._scene, self._records.light_frame(frame.number)
        device, count = scene.device, scene.vertex_count
        out = self.of(frame.number)
        if forms.wide(device):
            inputs = [light, count, scene.vertices, out]
            wp.launch(project_vertex_blocks, dim=-(-count // _BLOCK), inputs=inputs, device=device)
        else:
            wp.launch(project_vertices, dim=count, inputs=[light, scene.vertices, out], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._vertices.capacity)
