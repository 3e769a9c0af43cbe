# SPDX-License-Identifier: Apache-2.0
"""Triangles of charts that cast nothing for a light, counted without making their records.

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
from shadow_tracer.gpu.accelerators.silent import ROWS, SilentCounts, count_block
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.world import SceneBuffers


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
        count_row(chart, row, light, structure.heights, vertices, triangles, row % ROWS, counts)
    else:
        quads = chart.columns - 1
        first = chart.first_triangle + 2 * row * quads
        count_block(first, first + 2 * quads, light, 0, vertices, triangles, row % ROWS, counts)


class Silent:
    """Counts them."""

    def __init__(self, scene: SceneBuffers) -> None:
        self._scene = scene
        self._sums = SilentCounts(scene)

    def count(self, charts: Charts, light: LightFrame, cull: bool) -> tuple[int, int]:
        """How many triangles of all charts are degenerate, and how many are culled. Waits for the device."""
        scene, sums = self._scene, self._sums
        sums.begin()
        for number, placed in enumerate(charts.placed):
            if placed.chart.parallel and light.light[3] == 0.0 and not cull and not scene.left_out:
                inputs = [number, light.light, charts.structure, scene.vertices, scene.triangles, sums.counts]
                wp.launch(count_in_sun, dim=placed.grid[0] - 1, inputs=inputs, device=scene.device)
            else:
                sums.add(placed.first_triangle, placed.mesh.triangle_count, light, cull)
        return sums.total()

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self._sums.nbytes()
