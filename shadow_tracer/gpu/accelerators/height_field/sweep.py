# SPDX-License-Identifier: Apache-2.0
"""The sun over a whole terrain: bounds on the heights that hide it, carried along its way, decide most rays within a
cell or two (after the sweeps over terrain of Dozier and Frew 1990 and of Timonen and Westerholm 2010, who interpolate;
here nothing is said that is not certain, and what is not certain is left to the exact walk).

In a parallel chart a ray to the sun goes straight. Let *lines* be the columns, or the rows if the ray crosses more of
these, numbered along its way: from line to line it drifts by ``drift`` places, at most one either way, and rises by
``rise`` steps. With x the way along and v the place, v - drift x and h - rise x (its *level*) stay what they are. A
*band* b holds the rays with v - drift x from b to b + 1. From the last line to the first, for the rays of each band
that cross a line within the surface, three bounds are kept:

- *hides*: no point of the surface on this line or beyond it has a level above it. It is the largest level where an edge
  of the band comes to a line, a row between two quads, or a diagonal, and of the corners between the edges: these are
  the corners of what the band has of each triangle, and level is linear there. Where a position of the quads that the
  band touches is not valid, it is the largest level of those that are: each point of a triangle lies between three.
- *above*: each of these rays has a point, on this line or beyond, where the surface's level is at least this, and all
  quads from here to there are whole. It is the largest of the least levels on a line, as long as strips are whole.
- *below*: each has a point where the surface's level is at most this, in the same way.

On every sixteenth line there is a fourth one: *stretch*, like *hides*, but of the surface up to the sixteenth line from
there alone.

A ray (``profile.h``) goes from strip to strip between lines, and compares its height with the surface's wherever it
comes to a line, a row between two quads, or a diagonal: between these the surface is flat, so that what holds at both
ends holds between them. It is *clear* as long as it has been above the surface by more than ``_PAD`` everywhere. What
is said:

1. *Lit*, if it is clear up to a line and its level is above *hides* there; or clear until it leaves the surface. None
   of it meets the surface: not before the line, as it is clear, and not after. If its level is above *stretch*, it is
   clear up to the sixteenth line, and above the surface there: it goes on from that.
2. *Hidden*, if it is certainly above the surface at one of those places, and certainly below it at a later one, or the
   other way round, with whole quads between: within a strip, or by *above* or *below*. Then it meets the surface in
   between: take the last point where it is not yet on the other side, and the triangle that it is over right after it.
   Over that triangle the difference of heights is linear along the ray, zero at the point and not zero after it: so the
   sun is not in the triangle's plane, the sample is strictly on the other side of it, at the same distance along a
   linear function, and the point is in the closed triangle. That is what the exact decision asks (``decision.py``).
   A ray that begins on a line, certainly above the surface, is asked about *above* there already: the point that this
   tells of is not on the line itself, where the surface is below the ray. So is one that begins below it about *below*.
3. Everything else goes to the exact walk: so does a ray that begins beside the surface, that comes closer to it than
   ``_PAD``, meets a position that is not valid, or has not been decided after ``_PIECES`` pieces of its way.

With a bias the ray begins at the sample all the same: a clear one is lit whatever the bias is. The first place where it
is said to be above or below is at or behind the biased start, so the point in between is behind that. But the exact
decision compares ``abs(A) m`` and ``bias abs(D)`` of a triangle, which are right to a relative 1e-9 only. So with a
bias nothing is hidden by *above* or *below*, which know nothing of the triangle.
Within a strip the difference goes from above ``_PAD`` to below ``-_PAD`` on one triangle: then A and D are off, as
heights, by 2^-50 of lengths, and the point is at least ``_PAD`` behind the bias.

A sample that is a position of the surface, to the last bit, touches the triangles around it at their common corner, and
these never hide it: it is in their planes, which the exact decision finds (A = 0). Such a ray begins at the position,
and what is compared first is where it leaves these triangles: at the next line, or at a diagonal that does not come
from there. In whatever direction, that is the first place that is looked at.

*What is rounded.* Steps, places and lines are computed in float64, each within 6 * 2^-53 times its unit and the weight
of the ray's terms (``height_field.py``). Where weight times rows and columns is above 2^22 (``_WEIGHT``) nothing is
said; else places are within 2^-28 and heights within 2^-12 steps. Positions lie within 2^-27 (``BESIDE``) of their
places, else nothing is said, and values so near to a whole number are taken for it. The surface has slopes of at most
2^16 steps a place, in two directions, so 2^-27 + 2^-28 beside moves a height by less than 2^-9.4, twice for positions
and rays; float32 heights are off by 2^-9; the ray's rise, at most 2^16 steps a line (``_STEEPEST``), makes 2^-10.4 of
what is beside. Altogether it is less than 2^-7 steps, half of ``_PAD``.

A place that is passed by closer than 2^-27 may be passed on its other side. The surface is continuous there, and what
heights differ by is counted above; but there may be no quads. So quads are called whole only if all are that come
nearer to the ray, or to the band, than 2^-20. For the same reason a ray that leaves the surface across its border is
lit only if it drifts away from it by half a place each line: then it has left 2^-25.4 lines later, where it is lower
by less than 2^-7, surface and rise taken together, than where it was compared.
Nor does a band leave the surface as soon as it is beside it: up to a place beyond the border it counts what lies there,
so that a ray along the border, whose drift is nothing but rounding, does not lose what is in its way.

Levels in the bounds are float32, of heights and rises of up to M = 2^16 + abs(rise) * lines. One between two corners is
off by 3 * 2^-24 * 2^16, of its weights, products and sum, and by two roundings of up to 2^-24 M more; ``pad`` is 2^-21
M, so that 3 * 2^-24 M are left. These hold what heights are off, 2^-8, what the surface and the edges of bands are off
sideways, twice 2^-9.4 as above, and abs(rise) * 2^-26.4 of what is beside.

A ray takes part in this only as one of those that ask, and what is found is noted for each (``first_look.h``): hidden,
or that nothing of the chart hides it. Sixteen rays go together, in two registers of float64, with masks instead of
branches; each lane does what a ray alone would do, so nothing above changes. Those that are not decided after two
pieces of their way are collected, up to 512, and go on together up to eight, up to 32 and up to ``_PIECES``: else
fifteen would wait for the one that goes far. Whether a sample is a position of the surface is looked up only where it
is no further from its height than ``_PAD``: a position is within half of that.

It goes over heights that lie line by line; where lines are columns, these are turned once for the surface.
The sweep reads each height a few times and writes three numbers a cell, and the sixteenth part of one; a ray then reads
a few heights and one or two of the numbers. It is done for the largest terrain of a scene, for suns, where there are at
least an eighth as many samples as quads, and not where front faces are culled, as surfaces are open then, or where the
light ignores a mesh.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.height_field.charts import BESIDE, Charts, DeviceChart, Placed, Structure, Sweep
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.workers import Workers
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import InPlace
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.chart import STEPS

_LANES = wp.constant(16)
_TILE = wp.constant(16)
_BLOCK = wp.constant(8192)  # rays of a task in the wide form
_PAD = 2.0**-6  # steps
_WEIGHT = 2.0**22
_STEEPEST = 2.0**16  # steps a line
_PIECES = 128  # of a ray: the way to the next line, or row between two quads; or a stretch
_STRETCH = 16  # lines
_SHARE = 8  # quads to a sample
native.constants(SWEEP_WEIGHT=_WEIGHT, SWEEP_PAD=_PAD, SWEEP_PIECES=_PIECES, SWEEP_BESIDE=BESIDE)
native.constants(SWEEP_STRETCH=_STRETCH)


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


@native.func_native("accelerators/height_field/first_look.h", calls="FirstLook1::some")
def look_at_one(first: int, last: int, row: int, structure: Structure, asked: InPlace):
    """What the sweep says of a ray."""
    ...


@native.func_native("accelerators/height_field/first_look.h@16", calls="FirstLook16::some")
def look_at_some(first: int, last: int, row: int, structure: Structure, asked: InPlace):
    """What the sweep says of rays, sixteen at a time."""
    ...


@wp.kernel(enable_backward=False)
def look_at_rays(structure: Structure, asked: InPlace):
    look_at_one(wp.tid(), wp.tid() + 1, wp.tid(), structure, asked)


@wp.kernel(enable_backward=False)
def look_at_blocks(count: int, structure: Structure, asked: InPlace):
    first = wp.tid() * _BLOCK
    look_at_some(first, wp.min(first + _BLOCK, count), wp.tid(), structure, asked)


def look(count: int, structure: Structure, asked: InPlace, device: Any) -> None:
    """Let the sweep say what it can of ``count`` rays. Its kernels were loaded when the sweep was made."""
    if forms.wide(device):
        wp.launch(look_at_blocks, dim=-(-count // int(_BLOCK)), inputs=[count, structure, asked], device=device)
    else:
        wp.launch(look_at_rays, dim=count, inputs=[structure, asked], device=device)


@wp.kernel(enable_backward=False)
def turn_heights(first: int, rows: int, columns: int, heights: wp.array(dtype=float), turned: wp.array(dtype=float)):
    """Column by column, a tile each thread."""
    tile = wp.tid()
    across = (columns + _TILE - 1) // _TILE
    row, column = tile // across * _TILE, tile % across * _TILE
    for c in range(column, wp.min(column + _TILE, columns)):
        for r in range(row, wp.min(row + _TILE, rows)):
            turned[c * rows + r] = heights[first + r * columns + c]


class Sweeps:
    """Owns the bounds, and makes them for a sun.

    Attributes:
        sweep: the last one.
        bounds: what it has found.
    """

    def __init__(self, bounds: Bounds, scene: SceneBuffers) -> None:
        self._scene = scene
        quads = bounds.max_triangles // 2
        room = quads + quads // 4 + 4096
        self.bounds = wp.empty(3 * room + room // 8, dtype=float, device=scene.device)
        self.sweep = Sweep()
        self.sweep.number = -1
        self._turned = wp.empty(bounds.max_triangles, dtype=float, device=scene.device)  # as many as charts have
        self._made_for: tuple[object, ...] | None = None
        self._turned_for: tuple[object, ...] | None = None

    def forget(self) -> None:
        """The bounds are to be made once more, whatever is there."""
        self._made_for = self._turned_for = None

    def make(self, charts: Charts, light: LightFrame, samples: int, cull: bool, workers: Workers) -> None:
        """Sweep the largest chart of terrain, if that is worth it for so many samples and has not been done."""
        towards = np.array(light.light)
        placed = [each for each in charts.placed if each.chart.parallel]
        self.sweep = Sweep()
        self.sweep.number = -1
        if cull or towards[3] != 0.0 or not placed or self._scene.left_out:
            return
        largest = max(placed, key=lambda each: each.mesh.triangle_count)
        if samples * _SHARE < largest.mesh.triangle_count // 2:
            return
        number = charts.placed.index(largest)
        sweep = _sweep(number, charts.on_device[number], towards[:3])
        if sweep is None or (3 * sweep.lines + sweep.lines // _STRETCH + 1) * sweep.pitch > len(self.bounds):
            return
        made_for = (*largest.key, *towards)
        if self._made_for != made_for:
            self._made_for = None
            if sweep.by_rows:
                self._launch(sweep, charts.structure.heights, workers)
            else:
                self._turn(largest, charts)
                turned = _sweep(number, charts.on_device[number], towards[:3], turned=True)
                assert turned is not None
                self._launch(turned, self._turned, workers)
            self._made_for = made_for
        self.sweep = sweep

    def _turn(self, placed: Placed, charts: Charts) -> None:
        """Heights column by column, unless they are there."""
        if self._turned_for == placed.key:
            return
        self._turned_for = None
        rows, columns = placed.grid
        inputs = [placed.first_height, rows, columns, charts.structure.heights, self._turned]
        tiles = -(-rows // int(_TILE)) * -(-columns // int(_TILE))
        wp.launch(turn_heights, dim=tiles, inputs=inputs, device=self._scene.device)
        self._turned_for = placed.key

    def _launch(self, sweep: Sweep, heights: wp.array, workers: Workers) -> None:
        drift, device = sweep.drift * (sweep.lines - 1), self._scene.device
        first, last = math.floor(min(-drift, 0.0)) - 1, math.floor(max(-drift, 0.0)) + sweep.across + 1
        count = last - first + 1
        if not forms.wide(device):
            wp.launch(sweep_bands, dim=count, inputs=[sweep, first, heights, self.bounds], device=device)
            return
        wp.load_module(sweep_band_blocks.module, device, max_workers=0)  # not by several threads at once

        def some(begin: int, end: int) -> None:
            inputs = [sweep, first + int(_LANES) * begin, heights, self.bounds]
            wp.launch(sweep_band_blocks, dim=end - begin, inputs=inputs, device=device)

        blocks = -(-count // int(_LANES))
        parts = min(workers.count, blocks)
        workers.run([partial(some, blocks * k // parts, blocks * (k + 1) // parts) for k in range(parts)])

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.bounds.capacity + self._turned.capacity)


def _sweep(number: int, chart: DeviceChart, towards: np.ndarray, turned: bool = False) -> Sweep | None:
    """How the sun goes over a chart; None if it goes too steeply. ``turned``: over heights that begin with those of the
    chart, line by line, whatever lines are."""
    way = [float(np.dot(np.array(row)[:3], towards)) for row in (chart.s, chart.t, chart.h)]
    by_rows = abs(way[1]) > abs(way[0])
    along, over = (way[1], way[0]) if by_rows else (way[0], way[1])
    if not abs(way[2]) <= _STEEPEST * abs(along) or along == 0.0:
        return None
    sweep = Sweep()
    sweep.number = number
    rows, columns = chart.rows, chart.columns
    sweep.lines, sweep.across = (rows, columns) if by_rows else (columns, rows)
    sweep.pitch = (sweep.across // 32 * 2 + 3) * 16
    sweep.next_line, sweep.next = (columns, 1) if by_rows else (1, columns)
    sweep.base = chart.first_height
    if turned:
        sweep.base, sweep.next_line, sweep.next = 0, sweep.across, 1
    sweep.by_rows, sweep.mirrored = int(by_rows), int(along < 0.0)
    if along < 0.0:
        sweep.base += (sweep.lines - 1) * sweep.next_line
        sweep.next_line = -sweep.next_line
    sweep.drift, sweep.rise = over / abs(along), way[2] / abs(along)
    sweep.per_metre = abs(along) / float(np.linalg.norm(towards))
    sweep.pad = (STEPS + abs(sweep.rise) * sweep.lines) * 2.0**-21
    return sweep
