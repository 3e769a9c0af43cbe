# SPDX-License-Identifier: Apache-2.0
"""A triangle against boxes of tiles: conservative in both directions.

The planes are those that the shadow test has stored (``faces.py``): on a face of a light an edge plane is A u
+ B v + C, and the triangle's own plane P is linear in (u, v, t). A box is rejected if a plane is negative all over it
by more than its pad, or if the triangle's bounds miss it; the triangle covers the box if every plane is positive all
over it by more than its pad. So a box that holds an occluded ray is not rejected, and every ray of a covered box is
occluded, wherever the light is; there are no poles and no seams. Pads are those of ``light_space.py``, with M = 6 +
2.001 max |t|.
"""

from __future__ import annotations

# C++ for native functions, behind faces.TRIANGLE:
# Side: planes and bounds on one face; turn(it, seen, face) makes it;
# touches(b, side): the boxes that its bounds touch, of a group of sixteen at b, as bits;
# meets(b, side, covered): the boxes it cannot be said to miss, and those it covers.
SIDE = r"""
    struct Side {
        float a[3], b[3], c[3], ra[3], rb[3];      // edges, and absolute values
        float pa, pb, pc, pt, rpa, rpb;            // P
        float edge, plane;                         // factors of the pads
        float u0, u1, v0, v1, nearest;
        bool blind, bounded;
    };
    auto turn = [&](const Planes& it, int face) -> Side {
        const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
        const float sign = face & 1 ? -1.0f : 1.0f;
        Side s;
        for (int k = 0; k < 3; ++k) {
            s.a[k] = it.n[k][first];
            s.b[k] = it.n[k][second];
            s.c[k] = sign * it.n[k][axis];
            s.ra[k] = it.reach[k][first];
            s.rb[k] = it.reach[k][second];
        }
        s.pa = it.p[first];
        s.pb = it.p[second];
        s.pc = sign * it.p[axis];
        s.pt = it.p[3];
        s.rpa = it.spread[first];
        s.rpb = it.spread[second];
        s.edge = it.edge;
        s.plane = it.plane;
        s.blind = it.blind;
        s.bounded = false;
        s.u0 = s.v0 = -3.0f;
        s.u1 = s.v1 = 3.0f;
        s.nearest = 3.0e38f;
        return s;
    };
"""

# Sixteen boxes at a time, and `Side` with another meaning: a lane of the sixteen triangles that front_wide.py has taken
# up, seen on a face.
SIDE_SIXTEEN = r"""
    struct Side {
        const float *a, *b, *c;                    // of the first edge, along u, v and the face's axis; the next
        const float *pa, *pb, *pc, *pt;            // edge is 64 floats behind; of P
        float sign, edge, plane;                   // of the face's axis; factors of the pads
        float u0, u1, v0, v1, nearest;
        bool blind, bounded;
    };
    auto touches = [&](const float* b, const Side& s) -> int {
        const Sixteen cu = *(const Sixteen*)b, cv = *(const Sixteen*)(b + 16);
        const Sixteen eu = *(const Sixteen*)(b + 32), ev = *(const Sixteen*)(b + 48), t0 = *(const Sixteen*)(b + 64);
        return bits((cu - eu <= s.u1) & (cu + eu >= s.u0) & (cv - ev <= s.v1) & (cv + ev >= s.v0) & (t0 <= s.nearest));
    };
    auto meets = [&](const float* b, const Side& s, int& covered) -> int {
        const Sixteen cu = *(const Sixteen*)b, cv = *(const Sixteen*)(b + 16);
        const Sixteen eu = *(const Sixteen*)(b + 32), ev = *(const Sixteen*)(b + 48);
        const Sixteen t0 = *(const Sixteen*)(b + 64), t1 = *(const Sixteen*)(b + 80);
        if (s.blind) {
            covered = 0;
            return bits(eu >= 0.0f);
        }
        const Sixteen m = 6.0f + 2.001f * larger(size_of(t0), size_of(t1));
        const Sixteen edge = s.edge * m, plane = s.plane * m;
        const float a0 = s.a[0], a1 = s.a[64], a2 = s.a[128], b0 = s.b[0], b1 = s.b[64], b2 = s.b[128];
        const Sixteen c0 = a0 * cu + b0 * cv + s.sign * s.c[0], r0 = fabsf(a0) * eu + fabsf(b0) * ev;
        const Sixteen c1 = a1 * cu + b1 * cv + s.sign * s.c[64], r1 = fabsf(a1) * eu + fabsf(b1) * ev;
        const Sixteen c2 = a2 * cu + b2 * cv + s.sign * s.c[128], r2 = fabsf(a2) * eu + fabsf(b2) * ev;
        const Sixteen g = *s.pa * cu + *s.pb * cv + s.sign * *s.pc, h = fabsf(*s.pa) * eu + fabsf(*s.pb) * ev;
        const int mask = bits((cu - eu <= s.u1) & (cu + eu >= s.u0) & (cv - ev <= s.v1) & (cv + ev >= s.v0)
                              & (t0 <= s.nearest) & (c0 + r0 >= -edge) & (c1 + r1 >= -edge) & (c2 + r2 >= -edge)
                              & (g + h + *s.pt * t0 >= -plane));
        covered = mask & bits((c0 - r0 > edge) & (c1 - r1 > edge) & (c2 - r2 > edge) & (g - h + *s.pt * t1 > plane));
        return mask;
    };
"""
