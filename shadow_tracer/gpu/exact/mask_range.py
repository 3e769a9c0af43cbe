# SPDX-License-Identifier: Apache-2.0
"""Which points of a flat light a triangle may touch at all, as a sample sees it (``mask_range.h``), and its pads.

A light is flat if its points are m + a u + b v, with a and b from -1 to 1 (of a light at infinity, if the ends of its
ways are). From a sample p, with w = m - p, any place A (relative to p) is L (w + a u + b v) with::

    d = w.(u x v)      L = A.(u x v) / d      a L = A.(v x w) / d      b L = A.(w x u) / d

(the dual basis of w, u and v). The ray from p to point (a, b) goes through A if L > 0 and A's a and b are the point's.
A triangle all of whose corners have L > 0 is seen as a triangle with the corners' a and b, so it touches no point
outside of the ranges of these: a box of points, which tables of bins give by four look-ups.

Bounds. u = 2^-24; A, e, f, S, place and |.|_1 as in ``mask_filter.py``; the three vectors are P, rounded once from
float64. A is off by u place + u |A| per component, e by u |e|; P by u, a dot product by 3 u, the sum with e's by 1 u: a
corner's product with P by (u place + 6 u (|A| + S)) |P|_1; ``off |P|_1`` with off = 4 u place + 32 u (|A| + S) is five
times that. Let g be that for L and h for a L. With L > 64 g, a = (a L) / L is off by (h + |a| g) / (L - g), less than
1.02 (h + |a| g) / L; 1.1 is taken, and of L the least of three corners. The inverse is an approximation of the
processor, off by 2^-14 of a at most (Intel and AMD say 1.5 * 2^-12 of RCPPS, 2^-14 of VRCP14PS, which is what is used);
with that, ``1 / L`` is larger than 0.9999 of what it should be, which 1.1 has room for. 2^-12 |a| is added, and
``RANGE_PAD`` 1e-4, for the roundings of the sums that find the bin, 64 u (2 + |a|), and points that are not quite in
the plane (``FLAT``, times what a slanting ray makes of it, 1 / ``RANGE_SLOPE``: 1e-6). Beyond |a| = 2 nothing of that
can bring a range back to 1, as all but h is less than a quarter of |a|.

Where it is not used: where a corner is not surely in front of the sample (L > 64 g); where the sample is nearly in the
light's plane (d < 1e-3 |w| |u x v|); and where half sides are below 1e-6 of the reach of the filter, or that below 1e-6
of the scene's extent, since float32 tells nothing there. So a is 1e15 at most, and no product leaves float32: |P| <=
1e15, and L >= 1e-32.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.device import native
from shadow_tracer.scene.checks import FloatArray

# Along each side of a light; a Hammersley set of 64 has one point in each.
BINS = 64
# Corners so many bounds ahead of the sample are in front of it; what bins are off by; lights smaller than that, in
# parts of how far away they are, have no ranges; nor have those seen at a smaller sine.
native.constants(RANGE_BINS=BINS, RANGE_SURE=64.0, RANGE_PAD=1e-4, RANGE_LEAST=1e-6, RANGE_SLOPE=1e-3)
native.constants(RANGE_INVERSE=2.0**-12)
# Points this far off a plane, in parts of the lesser half side, are in it.
FLAT = 1e-9

Table = npt.NDArray[np.uint64]


def sides_of(offsets: FloatArray) -> tuple[FloatArray, Table] | None:
    """The two half sides of a flat light, (2, 3), and which of its points lie from each bin on along each, as bits of
    (2, BINS + 1) numbers, from (P, 3) offsets of points from its middle. None: it is not flat.

    The sides are horizontal and vertical as far as they can be: lamps and what is around them mostly are.
    """
    lengths = (offsets**2).sum(axis=1)
    first = offsets[lengths.argmax()]
    normals = np.cross(first, offsets)
    normal = normals[(normals**2).sum(axis=1).argmax()]
    size = np.sqrt((normal**2).sum())
    if not size > 1e-4 * lengths.max():
        return None
    normal = normal / size
    one = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    one /= np.sqrt((one**2).sum())
    two = np.cross(normal, one)
    places = [(offsets * way).sum(axis=1) for way in (one, two)]
    halves = [np.abs(place).max() for place in places]
    if not np.abs((offsets * normal).sum(axis=1)).max() <= FLAT * min(halves):
        return None
    powers = np.left_shift(np.uint64(1), np.arange(len(offsets), dtype=np.uint64))
    beyond = []
    for place, half in zip(places, halves, strict=True):
        bins = np.clip(((place / half + 1.0) * (0.5 * BINS)).astype(int), 0, BINS - 1)
        beyond.append(np.where(bins >= np.arange(BINS + 1)[:, None], powers, np.uint64(0)).sum(axis=1, dtype=np.uint64))
    return np.stack([halves[0] * one, halves[1] * two]), np.stack(beyond)
