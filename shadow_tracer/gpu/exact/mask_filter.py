# SPDX-License-Identifier: Apache-2.0
"""What the float32 filter for masks of light points (``mask_filter.h``) may be off by, and its constants.

A sample p looks at up to 64 points l of a light, past sixteen triangles a, b = a + e, c = a + f. Point l is hidden if
the plane of the triangle lies between the biased start and l, and the ray goes by all edges on the same side. With A =
a - p and n = e x f, and v = l - w p, w being 1, or 0 at infinity, that is asked of four linear forms of v::

    X.v = (A x e).v      Z.v = (A x (f - e) + n).v      -Y.v = -(A x f).v      g = n.v,  with q = n.A

The first three add up to g; all have the sign of g if the line through p and l meets the triangle, and g - w q has that
of q if l is beyond its plane. The biased start p + k v, k = bias / |v|, is on the sample's side of the plane if k |g| <
|q|.

Units: A, e and f are in units of the scene's extent, as the blocks have them (``accelerators/bvh/refit.h``); v is in
metres, at infinity in parts of the way to the middle of the light; q is multiplied by m, an extent in metres, at
infinity by 1, where the bias is divided by the extent instead. Forms are homogeneous, so signs do not change.

Bounds. u = 2^-24, |.| the largest component, |.|_1 the sum of magnitudes. S (``size``) is at least |e|_1, |f|_1 and |f
- e|_1. place = 1 + max(1, |p|). a and p are rounded once, |a| <= 1, so with the difference A is off by u place + u |A|
per component; e and f, rounded once, by u |e| and u |f|. v is held as middle + offset, both rounded once: 1.01 u L with
L (``reach``) at least the sum of both magnitudes. Let F = |A| + S.

*Edges.* A component of X is off by u place S + u |A| S of A, u |A| S of e, 2 u |A| S of the cross product; so is Y. A
component of n is off by 4 u S^2. Z has both, A's error once (it is crossed with f - e), and two sums of at most (|A| +
S) S: u place S + 10 u F S. No component of Z is greater than F S. Its product with the middle takes 3 u, three more
products and sums 4 u, a division by the band (once, of each factor) 2 u, v itself 1.01 u, all of F S L. The sum is u
(place + 20.1 F) S L; the band is u (4 place + 32 F) S L.

*Plane.* The magnitudes of n's terms add up to |e|_1 |f|_1 <= S^2 at most, those of their errors to 4 u S^2. g is off by
(4 + 1.01 + 3 + 4 + 2 + 1) u S^2 L of n, v, the middle, the offset, the division and the difference with q: 15.1 u; the
band (``there``) is 32 u S^2 L. q is off by 4 u S^2 |A| of n, by |n|_1 (u place + u |A|) of A, and by 3 u of the
product, 2 u of m, and 6 u of the difference with g and the division, all of S^2 |A|: 16 u S^2 |A| + u place |n|_1. The
band (``here``) is (32 u S^2 (|A| + 16 u place) + 4 u place |n|_1) m, in which |n|_1 is the computed one, off by 4 u
S^2: u place times that is what 16 u place is for, as it is for A in |A|.

*One over the band* is an approximation of the processor, within 2^-14 of it, the same for all factors of a form: so a
form that is compared with 1 is compared with a band that much smaller or greater, of which there is a third to spare.

*All points at once.* A form of any point is within sum |component| half of its value in the middle, half being the half
size of a box around the points. half is taken 1e-5 larger, which is more than the five roundings of that sum, and is
part of L.

*Bias.* k is between bias / longest and bias / shortest, the lengths of the ways to the farthest corner of the box and
to its nearest place, in float64 and 1e-5 beyond; where shortest is below 1e-6 longest its rounding would be more, and k
has no bound. (A sphere around the box would do, too, but many a sample is within that of a large flat light.) If |g| of
no point is below (|g of the middle| - half - there), and the least k times that is above |q| + here, the start of every
ray is beyond the plane, and so is all that follows: nothing is hidden, mostly by the sample's own surface. If |q| -
here is above the greatest k times the greatest |g|, bias plays no part and the sign of q is sure: only then the forms
say anything. What is in between goes to the float64 filter and the exact decision, as does a point whose forms are
within their bands.

*Underflow.* S >= 1e-20, L >= 1e-10 and place >= 2 make the edges' band 4e-37 at least, with errors of products below
1e-37 (L < 1e15 times 1.2e-38 of a component is below 1e-25 S L); the floor of 1e-25 in the plane's, times L or m, which
are 1e-10 at least, is more than underflow takes from n times L, or n times A times m. Samples for which L or m is not
between 1e-10 and 1e15 do without this filter.
"""

from __future__ import annotations

from shadow_tracer.gpu.device import native

# Bands: of what grows with the distance, what does not, and second orders; and the least that n's is (underflow).
native.constants(MASK_BAND=2.0**-19, MASK_PLACE=2.0**-22, MASK_TINY=2.0**-20, MASK_FLOOR=1e-25)
# By which part bounds in float64 are taken larger; and between what lengths may be [m].
native.constants(MASK_SLACK=1.00001, MASK_SMALLEST=1e-10, MASK_LARGEST=1e15)
# The most points of a light.
POINTS = 64
native.constants(MASK_MOST=POINTS)
