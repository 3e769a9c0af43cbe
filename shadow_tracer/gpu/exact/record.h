// needs: exact/determinant.h
// constants: GAP_VERTEX
// arguments: LightFrame frame
// The four planes of a triangle in a light's frame, and their error bounds: float64, rounded once. What compilers
// contract here is within the bounds; see docs/exactness.md, section 3.
struct Place {
    double u, v, w, z;

    inline double length() const { return fabs(u) + fabs(v) + fabs(w) + fabs(z); }
};
struct Plane {
    double x, y, z, error;
};
// Factors of the bounds, see records.py.
struct Factors {
    double edge, slope, offset, u32, setup, largest_offset;
};
// The frame in units of its scale.
struct Axes {
    double ux, uy, uz, vx, vy, vz, zx, zy, zz, ox, oy, oz, w_constant, w_slope;

    static inline Axes of(const LightFrame& frame) {
        const double scale = frame.inverse_scale;
        return { frame.r[0] * scale, frame.r[1] * scale, frame.r[2] * scale, frame.s[0] * scale, frame.s[1] * scale,
                 frame.s[2] * scale, frame.f[0] * scale, frame.f[1] * scale, frame.f[2] * scale, frame.center[0],
                 frame.center[1],    frame.center[2],    frame.w_constant,   frame.w_slope };
    }
    // A difference of two points, and a point of the world.
    inline Place turned(double x, double y, double z, double constant = 0.0) const {
        const double depth = zx * x + zy * y + zz * z;
        return { ux * x + uy * y + uz * z, vx * x + vy * y + vz * z, constant - w_slope * depth, depth };
    }
    inline Place at(double x, double y, double z) const { return turned(x - ox, y - oy, z - oz, w_constant); }
};
struct Record {
    Place a, b, c;
    Plane edge[3], own; // own.error is its slope's
    double edge_error, offset, offset_error;

    static inline double larger(double x, double y) { return x > y ? x : y; }
    // Through the light and an edge from a along e: a x e in (U, V, W), scaled to largest component 1, and its relative
    // error. e is a difference taken before rounding: a x (b - a), never a x b.
    static inline Plane through(const Place& a, const Place& e, double sign, double setup) {
        const double x = a.v * e.w - a.w * e.v, y = a.w * e.u - a.u * e.w, z = a.u * e.v - a.v * e.u;
        const double inverse = 1.0 / larger(larger(fabs(x), fabs(y)), fabs(z)), unit = sign * inverse;
        return { x * unit, y * unit, z * unit, setup * (1.0 + a.length()) * e.length() * inverse };
    }
    // side: of the plane, on which the light is, 1 or -1.
    static inline Record of(const Axes& axes, const Factors& factors, double ax, double ay, double az, double bx,
                            double by, double bz, double cx, double cy, double cz, double side) {
        Record r;
        r.a = axes.at(ax, ay, az);
        r.b = axes.at(bx, by, bz);
        r.c = axes.at(cx, cy, cz);
        const Place ab = axes.turned(bx - ax, by - ay, bz - az);
        const Place bc = axes.turned(cx - bx, cy - by, cz - bz);
        const Place ca = axes.turned(ax - cx, ay - cy, az - cz);
        r.edge[0] = through(r.a, ab, side, factors.setup);
        r.edge[1] = through(r.b, bc, side, factors.setup);
        r.edge[2] = through(r.c, ca, side, factors.setup);
        r.edge_error =
            factors.edge * factors.u32 + 2.0 * larger(larger(r.edge[0].error, r.edge[1].error), r.edge[2].error);
        // The own plane (N, D) in (U, V, Z), the light on its negative side: the frame (r, s, f) is right-handed, so
        // det[U V Z] keeps the sign. (b - a) x (c - a) = (a - c) x (b - a).
        const double x = ca.v * ab.z - ca.z * ab.v, y = ca.z * ab.u - ca.u * ab.z, z = ca.u * ab.v - ca.v * ab.u;
        const double inverse = 1.0 / larger(larger(fabs(x), fabs(y)), fabs(z)), flip = -side * inverse;
        const double error =
            factors.setup * (fabs(ab.u) + fabs(ab.v) + fabs(ab.z)) * (fabs(ca.u) + fabs(ca.v) + fabs(ca.z)) * inverse;
        r.own = { x * flip, y * flip, z * flip, factors.slope * factors.u32 + 2.0 * error };
        r.offset = r.own.x * r.a.u + r.own.y * r.a.v + r.own.z * r.a.z;
        const double extent = 1.0 + fabs(r.a.u) + fabs(r.a.v) + fabs(r.a.z);
        const double bound = factors.offset * factors.u32 * fabs(r.offset) + 2.0 * (error + factors.setup) * extent;
        r.offset_error = fabs(r.offset) < factors.largest_offset ? bound : HUGE_VAL;
        return r;
    }
    // (n_ab, s_e) (n_bc, s_N) (n_ca, s_D) (N, D)
    inline void store(float* ab, float* bc, float* ca, float* plane) const {
        ab[0] = (float)edge[0].x;
        ab[1] = (float)edge[0].y;
        ab[2] = (float)edge[0].z;
        ab[3] = (float)edge_error;
        bc[0] = (float)edge[1].x;
        bc[1] = (float)edge[1].y;
        bc[2] = (float)edge[1].z;
        bc[3] = (float)own.error;
        ca[0] = (float)edge[2].x;
        ca[1] = (float)edge[2].y;
        ca[2] = (float)edge[2].z;
        ca[3] = (float)offset_error;
        plane[0] = (float)own.x;
        plane[1] = (float)own.y;
        plane[2] = (float)own.z;
        plane[3] = (float)offset;
    }
    // One whose plane test is a certain no: g = 0 - 1 < -0.
    static inline void never(float* record) {
        for (int k = 0; k < 16; ++k)
            record[k] = k == 15 ? 1.0f : 0.0f;
    }
    // That of triangle i; returns 1 if it casts nothing because it is degenerate, 2 because it is culled, 0 if it is in
    // a gap or may cast a shadow.
    static inline int make(int i, const LightFrame& frame, double factor, double slope_factor, double offset_factor,
                           double u32, double setup, double largest_offset, const wp::array_t<wp::vec3d>& vertices,
                           const wp::array_t<wp::vec3i>& triangles, const wp::array_t<wp::vec4>& records, int cull) {
        const wp::vec3i corners = triangles.data[i];
        const wp::vec3d a = vertices.data[corners[0]], b = vertices.data[corners[1]], c = vertices.data[corners[2]];
        float* to = (float*)(records.data + 4 * (size_t)i);
        int side = 0, exact_used = 0;
        double value;
        // A side of 0: zero area, or seen exactly edge-on from the light.
        if (wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c))
            side = Determinant::sign(frame.light, b, c, a, value, exact_used);
        const bool off = cull != 0 && side > 0;
        if (side == 0 || off) {
            never(to);
            return corners[0] == GAP_VERTEX ? 0 : off ? 2 : 1;
        }
        const Factors factors = { factor, slope_factor, offset_factor, u32, setup, largest_offset };
        of(Axes::of(frame), factors, a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], side)
            .store(to, to + 4, to + 8, to + 12);
        return 0;
    }
};
