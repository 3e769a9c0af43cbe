// needs: exact/determinant.h exact/record.h
// constants: GAP_VERTEX
// arguments: LightFrame frame
// The record of one triangle.
struct OneRecord {
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
        const Factors1 factors = { factor, slope_factor, offset_factor, u32, setup, largest_offset };
        const Axes1 axes = Axes1::of(frame);
        const double corner[3][3] = { { a[0], a[1], a[2] }, { b[0], b[1], b[2] }, { c[0], c[1], c[2] } };
        const Place1 at[3] = { axes.at(a[0], a[1], a[2]), axes.at(b[0], b[1], b[2]), axes.at(c[0], c[1], c[2]) };
        double made[16];
        Record1::of(axes, factors, corner, at, side).list(made);
        for (int k = 0; k < 16; ++k)
            to[k] = (float)made[k];
        return 0;
    }
};
