# SPDX-License-Identifier: Apache-2.0
"""The sun over a whole terrain: heights that hide it, carried along its way."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.height_field.charts import BESIDE, Charts, DeviceChart, Sweep
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.chart import STEPS

_LANES = wp.constant(16)
_PAD = 2.0**-6
_STEEPEST = 2.0**20
_STEPS = 64
_SHARE = 8
_WEIGHT = 2.0**22
native.constants(SWEEP_WEIGHT=_WEIGHT, SWEEP_PAD=_PAD, SWEEP_STEPS=_STEPS, SWEEP_BESIDE=BESIDE)


@native.func_native("accelerators/height_field/sweep.h", calls="Sweeper1::bands")
def sweep_band(sweep: Sweep, band: int, heights: wp.array(dtype=float), bounds: wp.array(dtype=float)):
    """The bounds of a band."""
    ...


@native.func_native("accelerators/height_field/sweep.h@16", calls="Sweeper16::bands")
def sweep_sixteen(sweep: Sweep, band: int, heights: wp.array(dtype=float), bounds: wp.array(dtype=float)):
    """The bounds of sixteen bands."""
    ...


@wp.kernel(enable_backward=False)
def sweep_bands(sweep: Sweep, first: int, heights: wp.array(dtype=float), bounds: wp.array(dtype=float)):
    sweep_band(sweep, first + wp.tid(), heights, bounds)


@wp.kernel(enable_backward=False)
def sweep_band_blocks(sweep: Sweep, first: int, heights: wp.array(dtype=float), bounds: wp.array(dtype=float)):
    sweep_sixteen(sweep, first + _LANES * wp.tid(), heights, bounds)


class Sweeps:
    """Owns the bounds, and makes them for a sun."""

    def __init__(self, bounds: Bounds, scene: SceneBuffers) -> None:
        self._scene = scene
        quads = bounds.max_triangles // 2
        self.bounds = wp.empty(3 * (quads + quads // 4 + 4096), dtype=float, device=scene.device)
        self.sweep = Sweep()
        self.sweep.number = -1
        self._made_for: tuple[object, ...] | None = None

    def make(self, charts: Charts, light: LightFrame, samples: int, cull: bool) -> None:
        """Sweep the largest chart of terrain, if that is worth it."""
        self.sweep = Sweep()
        self.sweep.number = -1
        homogeneous = np.array(light.light)
        placed = [each for each in charts.placed if each.chart.parallel]
        if cull or homogeneous[3] != 0.0 or not placed:
            return
        largest = max(placed, key=lambda each: len(each.mesh.triangles))
        if samples * _SHARE < len(largest.mesh.triangles) // 2:
            return
        number = charts.placed.index(largest)
        sweep = _sweep(number, charts.on_device[number], homogeneous[:3])
        if sweep is None or 3 * sweep.lines * sweep.across > len(self.bounds):
            return
        drift = sweep.drift * (sweep.lines - 1)
        first, last = math.floor(min(-drift, 0.0)) - 1, math.floor(max(-drift, 0.0)) + sweep.across + 1
        inputs = [sweep, first, charts.structure.heights, self.bounds]
        count = last - first + 1
        if forms.wide(self._scene.device):
            wp.launch(sweep_band_blocks, dim=-(-count // int(_LANES)), inputs=inputs, device=self._scene.device)
        else:
            wp.launch(sweep_bands, dim=count, inputs=inputs, device=self._scene.device)
        self.sweep = sweep

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.bounds.capacity)


def _sweep(number: int, chart: DeviceChart, towards: np.ndarray) -> Sweep | None:
    """How the sun goes over a chart; None if it goes too steeply."""
    way = [float(np.dot(np.array(row)[:3], towards)) for row in (chart.s, chart.t, chart.h)]
    by_rows = abs(way[1]) > abs(way[0])
    along, over = (way[1], way[0]) if by_rows else (way[0], way[1])
    if not abs(way[2]) <= _STEEPEST * abs(along) or along == 0.0:
        return None
    sweep = Sweep()
    sweep.number = number
    rows, columns = chart.rows, chart.columns
    sweep.lines, sweep.across = (rows, columns) if by_rows else (columns, rows)
    sweep.next_line, sweep.next = (columns, 1) if by_rows else (1, columns)
    sweep.base = chart.first_height
    sweep.by_rows, sweep.mirrored = int(by_rows), int(along < 0.0)
    if along < 0.0:
        sweep.base += (sweep.lines - 1) * sweep.next_line
        sweep.next_line = -sweep.next_line
    sweep.drift, sweep.rise = over / abs(along), way[2] / abs(along)
    sweep.per_metre = abs(along) / float(np.linalg.norm(towards))
    sweep.pad = (STEPS + abs(sweep.rise) * sweep.lines) * 2.0**-22
    return sweep
