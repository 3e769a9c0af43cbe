// needs: device/lanes.h
// lanes
// arguments: LightFrame frame
// The four planes of LANES triangles in a light's frame, and their error bounds: float64, rounded once. What compilers
// contract here is within the bounds; see docs/exactness.md, section 3.
struct WIDE(Place) {
    typedef WIDE(Double) Double;
    Double u, v, w, z;

    inline Double length() const {
        typedef WIDE(Lanes) Lanes;
        return Lanes::absolute(u) + Lanes::absolute(v) + Lanes::absolute(w) + Lanes::absolute(z);
    }
};
struct WIDE(Plane) {
    WIDE(Double) x, y, z, error;
};
// Factors of the bounds, see records.py.
struct WIDE(Factors) {
    double edge, slope, offset, u32, setup, largest_offset;
};
// The frame in units of its scale.
struct WIDE(Axes) {
    typedef WIDE(Double) Double;
    typedef WIDE(Place) Place;
    double ux, uy, uz, vx, vy, vz, zx, zy, zz, ox, oy, oz, w_constant, w_slope;

    static inline WIDE(Axes) of(const LightFrame& frame) {
        const double scale = frame.inverse_scale;
        return { frame.r[0] * scale, frame.r[1] * scale, frame.r[2] * scale, frame.s[0] * scale, frame.s[1] * scale,
                 frame.s[2] * scale, frame.f[0] * scale, frame.f[1] * scale, frame.f[2] * scale, frame.center[0],
                 frame.center[1],    frame.center[2],    frame.w_constant,   frame.w_slope };
    }
    // A difference of two points, and a point of the world.
    inline Place turned(Double x, Double y, Double z, double constant = 0.0) const {
        const Double depth = zx * x + zy * y + zz * z;
        return { ux * x + uy * y + uz * z, vx * x + vy * y + vz * z, constant - w_slope * depth, depth };
    }
    inline Place at(Double x, Double y, Double z) const { return turned(x - ox, y - oy, z - oz, w_constant); }
    inline Place along(const Double (&from)[3], const Double (&to)[3]) const {
        return turned(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    }
};
struct WIDE(Record) {
    typedef WIDE(Double) Double;
    typedef WIDE(Lanes) Lanes;
    typedef WIDE(Place) Place;
    typedef WIDE(Plane) Plane;
    Plane edge[3], own; // own.error is its slope's
    Double edge_error, offset, offset_error;

    static inline Double size(Double x) { return Lanes::absolute(x); }
    static inline Double larger(Double x, Double y) { return x > y ? x : y; }
    // Through the light and an edge from a along e: a x e in (U, V, W), scaled to largest component 1, and its relative
    // error. e is a difference taken before rounding: a x (b - a), never a x b.
    static inline Plane through(const Place& a, const Place& e, Double sign, double setup) {
        const Double x = a.v * e.w - a.w * e.v, y = a.w * e.u - a.u * e.w, z = a.u * e.v - a.v * e.u;
        const Double inverse = 1.0 / larger(larger(size(x), size(y)), size(z)), unit = sign * inverse;
        return { x * unit, y * unit, z * unit, setup * (1.0 + a.length()) * e.length() * inverse };
    }
    // corner: in the world; at: what `axes` makes of them; side: of the plane, on which the light is, 1 or -1.
    static inline WIDE(Record) of(const WIDE(Axes) & axes, const WIDE(Factors) & factors, const Double (&corner)[3][3],
                                  const Place (&at)[3], Double side) {
        WIDE(Record) r;
        const Place &a = at[0], &b = at[1], &c = at[2];
        const Place ab = axes.along(corner[0], corner[1]), bc = axes.along(corner[1], corner[2]);
        const Place ca = axes.along(corner[2], corner[0]);
        r.edge[0] = through(a, ab, side, factors.setup);
        r.edge[1] = through(b, bc, side, factors.setup);
        r.edge[2] = through(c, ca, side, factors.setup);
        r.edge_error =
            factors.edge * factors.u32 + 2.0 * larger(larger(r.edge[0].error, r.edge[1].error), r.edge[2].error);
        // The own plane (N, D) in (U, V, Z), the light on its negative side: the frame (r, s, f) is right-handed, so
        // det[U V Z] keeps the sign. (b - a) x (c - a) = (a - c) x (b - a).
        const Double x = ca.v * ab.z - ca.z * ab.v, y = ca.z * ab.u - ca.u * ab.z, z = ca.u * ab.v - ca.v * ab.u;
        const Double inverse = 1.0 / larger(larger(size(x), size(y)), size(z)), flip = -side * inverse;
        const Double error =
            factors.setup * (size(ab.u) + size(ab.v) + size(ab.z)) * (size(ca.u) + size(ca.v) + size(ca.z)) * inverse;
        r.own = { x * flip, y * flip, z * flip, factors.slope * factors.u32 + 2.0 * error };
        r.offset = r.own.x * a.u + r.own.y * a.v + r.own.z * a.z;
        const Double extent = 1.0 + size(a.u) + size(a.v) + size(a.z), unknown = HUGE_VAL;
        const Double bound = factors.offset * factors.u32 * size(r.offset) + 2.0 * (error + factors.setup) * extent;
        r.offset_error = size(r.offset) < factors.largest_offset ? bound : unknown;
        return r;
    }
    // (n_ab, s_e) (n_bc, s_N) (n_ca, s_D) (N, D)
    inline void list(Double (&to)[16]) const {
        const Double all[16] = { edge[0].x, edge[0].y, edge[0].z, edge_error, edge[1].x, edge[1].y,
                                 edge[1].z, own.error, edge[2].x, edge[2].y,  edge[2].z, offset_error,
                                 own.x,     own.y,     own.z,     offset };
        for (int k = 0; k < 16; ++k)
            to[k] = all[k];
    }
};
