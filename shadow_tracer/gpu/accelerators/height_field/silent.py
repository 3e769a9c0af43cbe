# SPDX-License-Identifier: Apache-2.0
"""Triangles of charts that cast nothing for a light, counted without making their records.

Most quads are sure not to have any, at a glance at their heights. Let (S, T, H, D) be the light in the chart, a
direction or a position. A triangle with the slopes ``(ds, dt)``, in steps from column to column and row to row, and a
corner at (s, t, h) is seen edge-on, or has no area, only if ``H - h D = ds (S - s D) + dt (T - t D)``.

Heights are off by 2^-8 steps and positions by ``BESIDE`` of their places at most (else this is not used), which makes
slopes, of at most 2^16 steps, wrong by 2^-7 + 2^-8 with the rounding of their difference. In float32, the light is
rounded to 2^-24, and each product and difference to as much: with n = rows + columns, ``S - s D`` is off by 2^-23
abs(S) + 2^-22 n abs(D), which meets a slope; a product of that and a slope, the slope's own error, and two differences
add less than 2^-5 of abs(S) + n abs(D) together, and of T the same; ``H - h D`` is off by 2^-23 abs(H) + 2^-6 abs(D).
Altogether less than 2^-4 (abs(S) + abs(T) + n abs(D)) + 2^-20 abs(H). The light itself is made in float64: a row is off
by 2^-50 of what it is a sum of, which ``weight`` and ``weight_constant`` bound (``height_field.py``); slopes and places
make 2^-32 n of that, in units of ``nearest``. What is not sure, quads with a position that is not valid among it, is
decided exactly.

Quads of a depth image are cut along either diagonal, and a triangle over a step in depth is not there: there all four
that might be have to be sure.
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
def count_quads(
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
            if not cull and not scene.left_out:
                inputs = [number, light.light, charts.structure, scene.vertices, scene.triangles, sums.counts]
                wp.launch(count_quads, dim=placed.grid[0] - 1, inputs=inputs, device=scene.device)
            else:
                sums.add(placed.first_triangle, placed.mesh.triangle_count, light, cull)
        return sums.total()

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self._sums.nbytes()
