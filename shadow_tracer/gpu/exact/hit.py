# SPDX-License-Identifier: Apache-2.0
"""THE test of a camera's ray and a triangle, and which of two hits is closer.

The ray of a pixel is o + t d: o the optical centre as given, d = (R0 x + R1 y) + R2 with x = (column - cx) / fx and y =
(row - cy) / fy, or x and y of the camera's table, every operation rounded to float64 and none fused. o and d are taken
as exact, as the corners are.

It meets a triangle iff d lies in the closed cone of the triangle: with the exact determinants D = det[o - a, b - a, c -
a] and E_ab = det[d, o - a, b - a] (and cyclic), iff D is not zero and no D E is negative. E_bc / D is a's share in d =
sum of shares times corners, so t > 0 follows and needs no test: there is no near plane. A triangle seen exactly
edge-on, without area, or with a corner that is not finite has D = 0 and is not met.

The hit's depth is t, in float64 without contraction from the triangle's plane, kept between the depths of its corners.
The least depth wins, of equal ones the least triangle index: that does not depend on the order in which triangles come.

float32 answers what it can: edges n . h > s_e m sure, n . h < -s_e m no (``docs/exactness.md`` section 3), and inverse
depths that are more than s_q m away from each other (``camera_records.py``). Of a ray's best triangle the filter keeps
the two bounds of its inverse depth. One ray and sixteen are judged by one text (``ray_test.h``), what that leaves open
by another (``hit.h``), and so is every ray, by whatever it is shown triangles.
"""

from __future__ import annotations

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.counters import ROWS

# Columns of the counters.
COUNTERS = ("tests", "retested", "exact", "compared")
COUNTER_SHAPE = (ROWS, len(COUNTERS))
native.constants(CAMERA_TESTS=0, CAMERA_RETESTED=1, CAMERA_EXACT=2, CAMERA_COMPARED=3)
