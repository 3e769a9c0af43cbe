# SPDX-License-Identifier: Apache-2.0
"""The scene's vertices in light space, for tests that need corners and not only planes."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.changes import Changed
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.slots import Range

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
    first: int, light: wp.array(dtype=LightFrame), vertices: wp.array(dtype=wp.vec3d), out: wp.array(dtype=wp.vec4)
):
    """One vertex per thread, those from ``first`` on."""
    i = first + wp.tid()
    project_block(light[0], i, i + 1, vertices, out)


@wp.kernel(enable_backward=False)
def project_vertex_blocks(
    begin: int,
    end: int,
    light: wp.array(dtype=LightFrame),
    vertices: wp.array(dtype=wp.vec3d),
    out: wp.array(dtype=wp.vec4),
):
    first = begin + wp.tid() * _BLOCK
    project_block(light[0], first, wp.min(first + _BLOCK, end), vertices, out)


def project(light: wp.array, vertices: wp.array, out: wp.array, some: Range) -> None:
    """Project some vertices for a light (one LightFrame on the device)."""
    first, last = some
    inputs = [light, vertices, out]
    if forms.wide(out.device):
        blocks = -(-(last - first) // _BLOCK)
        wp.launch(project_vertex_blocks, dim=blocks, inputs=[first, last, *inputs], device=out.device)
    else:
        wp.launch(project_vertices, dim=last - first, inputs=[first, *inputs], device=out.device)


class Corners:
    """(U, V, W, Z) of the scene's vertices for as many lights as there are triangle records of."""

    def __init__(self, records: TriangleRecords) -> None:
        self._records, self._scene = records, records.scene
        self._vertices = wp.empty(records.most_vertices, dtype=wp.vec4, device=self._scene.device)
        self._slices = Slices()

    @property
    def stride(self) -> int:
        """Vertices from a light to the next one."""
        return self._records.vertex_stride

    def of(self, light: int, lights: int = 1) -> wp.array:
        """Vertices for ``lights`` lights from number ``light`` on, ``stride`` apart."""
        return self._slices(self._vertices, self._records.place(light) * self.stride, lights * self.stride)

    def make(self, frame: LightFrame, changed: Changed) -> None:
        """Make those that have changed for the light of ``frame``; to be done whenever its triangle records are
        made."""
        light = self._records.light_frame(frame.number)
        for some in changed.vertices:
            project(light, self._scene.vertices, self.of(frame.number), some)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._vertices.capacity)
