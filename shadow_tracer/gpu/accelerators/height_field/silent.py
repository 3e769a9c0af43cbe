# SPDX-License-Identifier: Apache-2.0
"""Triangles that cast nothing for a light, counted without making their records.

Of terrain in the sun most quads are sure not to have any, at a glance at their heights: a triangle with the slopes
``(ds, dt)``, in steps from column to column and row to row, is seen edge-on, or has no area, only if ``h = s ds + t
dt``, with (s, t, h) the way to the sun in the chart. Heights are off by 2^-8 steps and positions by ``SWEEP_BESIDE`` of
their places at most (else this is not used), which makes slopes, of at most 2^16 steps, wrong by 2^-7 + 2^-8; float32
rounds the differences and products by 2^-7 (abs(s) + abs(t)) and 2^-22 abs(h) more. Together less than 2^-5 (abs(s) +
abs(t)) + 2^-20 abs(h). What is not sure, quads with a position that is not valid among it, is decided exactly.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.height_field.charts import BESIDE, Charts, DeviceChart, Structure
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.world import SceneBuffers

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


@native.func_native("accelerators/height_field/silent_row.h", calls="SilentRow::count")
def count_row(
    chart: DeviceChart,
    row: int,
    light: wp.vec4d,
    heights: wp.array(dtype=float),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    to: int,
    counts: wp.array(dtype=wp.vec2i),
):
    """Add to ``counts[to]`` how many triangles of a row of quads are degenerate."""
    ...


@wp.kernel(enable_backward=False)
def count_in_sun(
    number: int,
    light: wp.vec4d,
    structure: Structure,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    counts: wp.array(dtype=wp.vec2i),
):
    """A row of quads per thread."""
    row = wp.tid()
    chart = structure.charts[number]
    if structure.beside[number] <= wp.float64(BESIDE):
        count_row(chart, row, light, structure.heights, vertices, triangles, row % _ROWS, counts)
    else:
        quads = chart.columns - 1
        first = chart.first_triangle + 2 * row * quads
        count_block(first, first + 2 * quads, light, 0, vertices, triangles, row % _ROWS, counts)


class Silent:
    """Counts them."""

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        self._counts = wp.zeros(int(_ROWS), dtype=wp.vec2i, device=scene.device)

    def count(self, charts: Charts, light: LightFrame, cull: bool) -> tuple[int, int]:
        """How many triangles of all charts are degenerate, and how many are culled. Waits for the device."""
        scene = self._scene
        ours = [scene.vertices, scene.triangles, self._counts]
        self._counts.zero_()
        for number, placed in enumerate(charts.placed):
            if placed.chart.parallel and light.light[3] == 0.0 and not cull and not scene.left_out:
                inputs = [number, light.light, charts.structure, *ours]
                wp.launch(count_in_sun, dim=placed.grid[0] - 1, inputs=inputs, device=scene.device)
            else:
                first, count = placed.first_triangle, len(placed.mesh.triangles)
                inputs = [first, first + count, light.light, int(cull), *ours]
                wp.launch(count_silent, dim=-(-count // int(_BLOCK)), inputs=inputs, device=scene.device)
        degenerate, culled = (int(value) for value in self._counts.numpy().sum(axis=0))
        return degenerate, culled

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._counts.capacity)
