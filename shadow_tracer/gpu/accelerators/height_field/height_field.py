# SPDX-License-Identifier: Apache-2.0
"""Surfaces as heights over rows and columns, in a tree of boxes that needs no build: terrain, and depth images as
occluders (maximum mipmaps: Tevs, Ihrke, Seidel 2008; here with the least heights as well, and four by four children).

What has a chart (``charts.py``) is in nodes of least and largest heights; meshes and all other surfaces go through
another accelerator (``union.py``). Rays are taken into each chart, clipped there, and go down the nodes; the two
triangles of each quad that it may meet are decided from their coordinates in the scene (``visibility/in_place.h``). A
sun over terrain is swept first (``sweep.py``): most rays need no node then.

Why no triangle can be missed. Let a chart's rows be the numbers that stand on the device, x a point relative to its
centre (an exact difference of what is given, rounded once), and (S, T, H, D) what they take it to. The map takes lines
to lines and, where D > 0, segments to segments and triangles to triangles: corner by corner. A triangle of quad (r, c)
lies, with ``beside`` in hand, within c - beside to c + 1 + beside in s, the same in t, and between the heights of its
corners in h. So boxes of quads, padded, hold it, and boxes of boxes hold these. Let E be the unit that paddings are
relative to: along s and t the number of the last row or column, whichever is larger; along h 65535 steps; u = 2^-24.

*What float64 rounds.* ``weight`` times the sum of a point's magnitudes, plus ``weight_constant``, bounds the sum of the
magnitudes of the terms of each row, for the point and for all that lies among the positions, in units of E and of the
least D. A ray for which that is above 2^20 is shown all quads (``TOO_FAR``). Below, a row is within 6 * 2^-53 * 2^20 <
2^-30 of exact in these units, for the sample, for every position, and for every point of the ray among them, which is
the sample's row and a multiple of the way's. The way's row is the light's less the sample's, and what is taken of both
lies among the positions: so that adds no more than 2^-28. A position, whose D is at least ``nearest``, has s, t and h
within 2^-29 E, and a point of the ray, where D is at least half of that, within 2^-25 E.

*The bias.* What hides a sample lies at least as far along its ray as the bias: of anything nearer than 1 - 2e-9 of it
the exact decision says no (``exact/decision.h``: the distances that it compares are right to 1e-9 each, the rest to a
few 2^-53). So a ray begins at 1 - 2^-12 of its bias (``ChartRay::begins``), which spares it what lies around its
sample. That is computed in float32, with a reciprocal that is right to 2^-14, and all else to a few u: together less
than 2^-13. Where the square of the way's length is not between 1e-30 and 1e30, it begins at the sample. Of a bias
beyond the light nothing is left, and the decision says no as well: so rays need not be known, but for their number.

*Clipping.* The part of a ray that can meet a triangle of the chart lies within the rows, columns and heights,
``beside`` in hand, and each of these is a linear inequality in the parameter p of the ray: I + p G >= 0, where I is how
far inside a plane it begins. The planes are moved outwards by 2^-18 E, which at a point that can meet something, whose
D is at least ``nearest``, is much more than what float64 rounds. Of what is computed in float32 from there, I is off by
6 u of (abs(x) + E abs(D)), and G by 5 u of the same of the way; ``ChartRay::clip`` adds 16 u to I, and takes G up to 8
u higher or lower. So at all p that count the sum of I and p times the highest G is not negative: if I is not, p is at
most I over what is left of -G, and else at least -I over G, if that grows at all. Two reciprocals are right to 2^-14
each: the ends are moved outwards by 2^-12. From where a ray comes to the chart it is clipped once more, as 2^-12 of a
long way is long: so it begins no more than E / 16 outside. A ray whose I and G float32 does not hold, as sizes in the
chart or the way to a sun are far from all that is usual, or one without an end in the chart, is ``TOO_FAR``. What is
left may begin or end a little in front of all positions, as an end has been moved by a part of the way: there it ends
where D is half of ``nearest`` (``ChartRay::in_front``), and no triangle reaches there. So D > 0 all along it.

*Down the nodes.* As in ``segment.py`` the segment's begin b and span m are rounded to float32, within 1 u E and 2 u E.
Where it comes to the middle c of a box is c/m - b/m, with the reciprocal of m (1 u of both, 2 u E), b/m rounded (1 u
E), and the difference (2 u E, or 3 u E where product and difference round apart); half of the box's size, at most E /
2, and the padding are multiplied with the reciprocal (3 u of them) and subtracted or added (2 u E): altogether less
than 11 u E, and with what begin and span are off less than 16 u E, of 32 u E that boxes are padded with: 2^-19 E, and
``beside`` in s and t. Heights are rounded outwards to whole steps, after they have been moved by 2^-6 of one
(``ROUNDED``): float32 heights are off by 2^-9 steps, and 2^-13 from what float64 rounds. A span below 1e-20 is taken
for 1e-20, which moves a point of the ray by that. Beyond the segment's end there is 1e-4 of it more. An empty box has a
least height above its largest one.

*Sixteen at a time.* On the CPU, tiles of four by four pixels, or sixteen points, go down the nodes as a bundle
(``bundle.h``): where their rays are at a part p of their segments lies, along each axis, between b + p m and B + p M,
with the least and the largest begins b, B and spans m, M. Say a ray of begin c and span n, both as rounded, meets a box
from l to h at p, but for e < 16 u E, so that c + p n >= l - e. With B >= c + 32 u E, but for 1 u E, and M >= n it is p
M >= l - B + 15 u E. The bundle takes l/M - B/M for where it gets past that side, and what that rounds, reciprocal, both
products and the difference, is less than 8 u E, whatever n is: so p lies behind that, or, where M < 0, before it. At
the other side it is the same with b, h and m. All sides are compared with the same p, which is within what is left of 0
to 1.0001. A bound of spans within 1e-20 of zero becomes the wider one of 1e-20. Each quad that the bundle meets is then
compared with the rays one by one, as above. Rays that lie more than 64 cells apart are bundles of one. A bundle begins
at the smallest node that it is in: padded, of which the above takes 16 u E and ``ChartBundle::among`` 3 u E, each quad
that a ray of it meets is among the rows and columns from the least to the largest of b + p m and B + p M.

*Planes of quads.* What a quad has of triangles lies, in the chart, between two parallel planes (``quad_planes.h``):
with the heights a, b and, in the next row, c, d of its corners the one in the middle rises by the mean of b - a and d -
c along s and of c - a and d - b along t, and has the mean of all four at the quad's middle; corners are abs(a + d - b -
c) / 4 above or below it. Let G be the sum of how steeply it rises along both, in steps a cell, and W = 65536 + G E.
Heights are off by 2^-8 = u 65536 steps, the plane's numbers, as rounded, altogether by 5 u 65536, and positions by
``beside`` of their places: so corners, and all between them, are 6 u W + G ``beside`` farther from the plane of these
numbers at most. Where a ray meets a triangle, between where it comes to the quad's rows and columns, padded as above,
and where it leaves them, it is off by 4 u E in s and t and by 4 u 65536 in h: another 4 u W. Its height above the plane
is linear in p: so it is not above all this at both ends, and not below it at both. What is computed there is off by 11
u W, as no term is above 9/8 W: four roundings where the ray begins, three of how fast it rises, product and sum; and
``thick`` by 2 u W. That is 23 u W, of 32 u W in ``thick``: 2^-19 E, and ``beside``, for each step of G, and 2^-19 of
all steps. A corner in no triangle does no harm, and one without a height makes all of it not a number, which spares
nothing.

Memory: a quad costs 4.3 bytes in nodes and a position 4 bytes of height, beside 24 bytes of coordinates and, for each
of two triangles, 12 bytes of numbers: 56 bytes a cell, and as many on the host. For a sun that is swept there are 20.25
bytes a cell more. No records are made.
"""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from shadow_tracer.gpu.accelerators.height_field.charts import Charts, Structure
from shadow_tracer.gpu.accelerators.height_field.silent import Silent
from shadow_tracer.gpu.accelerators.height_field.sweep import Sweeps, look
from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.surfaces import Surfaces
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.visibility.queries import IN_PLACE, InPlace
from shadow_tracer.scene.mesh import Mesh

_SIXTEEN = Walk("accelerators/height_field/packets.h", Structure, lanes=16, queries=(IN_PLACE,))
_ONE = Walk("accelerators/height_field/down.h", Structure, queries=(IN_PLACE,))


class HeightFields(Surfaces):
    """The ``height_field`` pipeline."""

    def __init__(self, variant: str, context: Context) -> None:
        super().__init__(context)
        self._charts: Charts = context.scene.made.take(Charts, lambda: Charts(context.scene))
        self._silent: Silent = context.scene.made.take(Silent, lambda: Silent(context.scene))
        self._sweeps: Sweeps = context.shared.take(Sweeps, lambda: Sweeps(context.records.bounds, context.scene))
        self._passed = wp.empty(context.samples.bounds.max_rays, dtype=wp.uint8, device=context.samples.device)
        self.walk = _SIXTEEN if forms.wide(context.samples.device) else _ONE

    def structure(self) -> Structure | None:
        """All charts."""
        return self._charts.structure if self._charts.placed else None

    def make(self) -> Sequence[Mesh]:
        """Charts of surfaces that have changed."""
        self._charts.follow()
        return self._charts.others

    def forget(self) -> None:
        """Charts, the sweep, and what the meshes go through, are to be made again."""
        self._charts.forget()
        self._sweeps.forget()
        self._rest.forget()

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records of the meshes, and the sweep of a sun."""
        super().aim(lights)
        context, charts, sweeps = self._context, self._charts, self._sweeps
        # One band does it for all, and a sweep is worth what they all ask.
        count = context.samples.count * context.samples.bands
        with context.stages.stage("setup"):
            sweeps.make(charts, lights[0], count, context.records.front_face_culling, context.workers)
            charts.structure.sweep, charts.structure.bounds = sweeps.sweep, sweeps.bounds

    def first_look(self, asked: InPlace) -> None:
        """What the sweep says of the rays of a sun."""
        structure, samples = self._charts.structure, self._context.samples
        if structure.sweep.number >= 0:
            asked.passed = self._passed
            look(samples.count, structure, asked, samples.device)

    def nbytes(self) -> int:
        """Bytes on the device, those that all bands have in common aside."""
        return super().nbytes() + int(self._passed.capacity)

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Of the meshes, as their records say, and of the charts."""
        rest = self._rest.silent(light)
        ours = self._silent.count(self._charts, light, self._context.records.front_face_culling)
        return rest[0] + ours[0], rest[1] + ours[1]
