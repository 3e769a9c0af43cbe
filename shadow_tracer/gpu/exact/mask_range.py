# SPDX-License-Identifier: Apache-2.0
"""Which points of a flat light or a tube a triangle may touch at all, as a sample sees it (``mask_range.h``), and its
pads.

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

Boxes of the tree are asked in the same way: what is in a box has L, a L and b L between those of two of its corners
each. If the least L is in front, a is from the least a L divided by the least L (by the greatest, if a L is not
negative) to the greatest a L, divided likewise. A corner of a box has no edges and so less error than one of a
triangle; padding that boxes have comes on top.

A tube is all within a radius r of a line m + a u, a from -1 to 1. A sample at a distance t from that line sees it as a
ribbon: v is across w and u. A point q = m + a u + b v + c k, k of length 1 across u and v, so that w = x u + t k, is
seen in the place of the plane that (w + a u + b v + c k) / (1 + c / t) leads to, as k = (w - x u) / t::

    a' = (x + a) / (1 + c / t) - x        b' = b / (1 + c / t)

With |a| <= 1, |c| <= r and p = r / t, a' is off a by (1 + |x|) p / (1 - p) at most, which is added to the pad, and b'
is within r / ((1 - p) |v|), which is 1: so half of the ribbon's width is chosen, or twice the least that has ranges.
Bins along u alone tell points apart. There are no ranges where p is 1 / 4 or more.

Where it is not used: where a corner is not surely in front of the sample (L > 64 g); where the sample is nearly in the
light's plane (d < 1e-3 |w| |u x v|); and where half sides are below 1e-6 of the reach of the filter, or that below 1e-6
of the scene's extent, since float32 tells nothing there. So a is 1e15 at most, and no product leaves float32: |P| <=
1e15, and L >= 1e-32.
"""

from __future__ import annotations

from typing import NamedTuple

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
# Tubes are thinner than that, in parts of their half length: others have ranges that say little. And the least p where
# there are none.
THIN = 0.25
native.constants(RANGE_ROUND=0.25)

Table = npt.NDArray[np.uint64]


class Sides(NamedTuple):
    """A flat light, or a tube.

    Attributes:
        radius: of a tube [m], 0 of a flat light.
        u, v: half sides; of a tube half of the axis, and nothing.
        beyond: of each bin along both, and of what is behind the last, the points that lie from there on, as bits of
            (2, BINS + 1) numbers; across a tube all of them lie in the first bin.
    """

    radius: float
    u: FloatArray
    v: FloatArray
    beyond: Table


def sides_of(offsets: FloatArray) -> Sides | None:
    """Those of (P, 3) points, given from their middle; None if they are neither in a plane nor near a line.

    Sides are horizontal and vertical as far as they can be: lamps and what is around them mostly are.
    """
    return _flat(offsets) or _tube(offsets)


def _flat(offsets: FloatArray) -> Sides | None:
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
    beyond = [_beyond(place / half) for place, half in zip(places, halves, strict=True)]
    return Sides(0.0, halves[0] * one, halves[1] * two, np.stack(beyond))


def _tube(offsets: FloatArray) -> Sides | None:
    axis = np.linalg.eigh((offsets[:, :, None] * offsets[:, None]).sum(axis=0))[1][:, -1]
    along = (offsets * axis).sum(axis=1)
    half = np.abs(along).max()
    radius = np.sqrt(((offsets - along[:, None] * axis) ** 2).sum(axis=1).max()) + FLAT * half
    if not radius < THIN * half:
        return None
    return Sides(float(radius), half * axis, np.zeros(3), np.stack([_beyond(along / half), _beyond(0.0 * along - 1.0)]))


def _beyond(places: FloatArray) -> Table:
    """Of places from -1 to 1."""
    powers = np.left_shift(np.uint64(1), np.arange(len(places), dtype=np.uint64))
    bins = np.clip(((places + 1.0) * (0.5 * BINS)).astype(int), 0, BINS - 1)
    return np.where(bins >= np.arange(BINS + 1)[:, None], powers, np.uint64(0)).sum(axis=1, dtype=np.uint64)
