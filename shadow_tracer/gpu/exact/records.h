// cpu
// needs: exact/determinant.h
// constants: RECORDS_BLOCK
// arguments: LightFrame frame
// First the side the light is on, as Determinant::sign decides it, without contraction; what it leaves open gets the
// exact sign one by one (no permanent is above 1e-15 of NaN, so corners that are not finite are left open, too). Then
// the planes; the filter's bound covers any contraction of them, and one reciprocal in place of several divisions.
struct Records : Determinant {
    static inline void block(int first, int count, const LightFrame& frame, double factor, double slope_factor,
                             double offset_factor, double u32, double setup, double largest_offset,
                             const wp::array_t<wp::vec3d>& vertices, const wp::array_t<wp::vec3i>& triangles,
                             int first_record, const wp::array_t<wp::vec4>& records, int first_corner,
                             const wp::array_t<float>& corners, int cull, int first_row,
                             const wp::array_t<int>& degenerate, const wp::array_t<int>& culled) {
        const int n = count - first < RECORDS_BLOCK ? count - first : RECORDS_BLOCK;
        double ax[RECORDS_BLOCK], ay[RECORDS_BLOCK], az[RECORDS_BLOCK], bx[RECORDS_BLOCK], by[RECORDS_BLOCK],
            bz[RECORDS_BLOCK], cx[RECORDS_BLOCK], cy[RECORDS_BLOCK], cz[RECORDS_BLOCK], side[RECORDS_BLOCK];
        wp::uint8 open[RECORDS_BLOCK];
        typedef float Four[4];
        Four record[4][RECORDS_BLOCK];
        float corner[12][RECORDS_BLOCK];
        for (int j = 0; j < n; ++j) {
            const wp::vec3i corners = triangles.data[first + j];
            const wp::vec3d &a = vertices.data[corners[0]], &b = vertices.data[corners[1]],
                            &c = vertices.data[corners[2]];
            ax[j] = a[0];
            ay[j] = a[1];
            az[j] = a[2];
            bx[j] = b[0];
            by[j] = b[1];
            bz[j] = b[2];
            cx[j] = c[0];
            cy[j] = c[1];
            cz[j] = c[2];
        }
        const double lx = frame.light[0], ly = frame.light[1], lz = frame.light[2], lw = frame.light[3];
        int any_open = 0;
        for (int j = 0; j < n; ++j) {
            const double qx = sub(lx, mul(lw, ax[j])), qy = sub(ly, mul(lw, ay[j])), qz = sub(lz, mul(lw, az[j]));
            const double rx = sub(bx[j], ax[j]), ry = sub(by[j], ay[j]), rz = sub(bz[j], az[j]);
            const double sx = sub(cx[j], ax[j]), sy = sub(cy[j], ay[j]), sz = sub(cz[j], az[j]);
            const double x0 = mul(ry, sz), x1 = mul(rz, sy), y0 = mul(rz, sx), y1 = mul(rx, sz);
            const double z0 = mul(rx, sy), z1 = mul(ry, sx);
            const double value = add(add(mul(qx, sub(x0, x1)), mul(qy, sub(y0, y1))), mul(qz, sub(z0, z1)));
            const double permanent =
                add(add(mul(fabs(qx), add(fabs(x0), fabs(x1))), mul(fabs(qy), add(fabs(y0), fabs(y1)))),
                    mul(fabs(qz), add(fabs(z0), fabs(z1))));
            const int sure = fabs(value) > 1.0e-15 * permanent;
            side[j] = sure ? (value > 0.0 ? 1.0 : -1.0) : 0.0;
            open[j] = !sure & !(permanent == 0.0);
            any_open |= open[j];
        }
        if (any_open) {
            for (int j = 0; j < n; ++j) {
                const wp::vec3d a(ax[j], ay[j], az[j]), b(bx[j], by[j], bz[j]), c(cx[j], cy[j], cz[j]);
                double value;
                int exact_used = 0;
                if (open[j] && wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c))
                    side[j] = sign(frame.light, b, c, a, value, exact_used);
            }
        }
        int nothing = 0, front = 0; // front: turned towards the light and culled
        for (int j = 0; j < n; ++j) {
            nothing += side[j] == 0.0;
            const int off = (cull != 0) & (side[j] > 0.0);
            front += off;
            side[j] = off ? 0.0 : side[j];
        }
        const int row = first_row + ((first / RECORDS_BLOCK) & 63);
        // Several threads may make records of one light.
        if (nothing)
            __atomic_fetch_add(&degenerate.data[row], nothing, __ATOMIC_RELAXED);
        if (front)
            __atomic_fetch_add(&culled.data[row], front, __ATOMIC_RELAXED);
        {
#pragma clang fp contract(fast)
            const double scale = frame.inverse_scale, w_constant = frame.w_constant, w_slope = frame.w_slope;
            const double ux = frame.r[0] * scale, uy = frame.r[1] * scale, uz = frame.r[2] * scale;
            const double vx = frame.s[0] * scale, vy = frame.s[1] * scale, vz = frame.s[2] * scale;
            const double zx = frame.f[0] * scale, zy = frame.f[1] * scale, zz = frame.f[2] * scale;
            const double ox = frame.center[0], oy = frame.center[1], oz = frame.center[2];
            const double rounding = factor * u32;
            struct Place {
                double u, v, w, z;
            };
            struct Plane {
                double x, y, z, error;
            };
            auto turned = [&](double x, double y, double z, double constant) {
                const double depth = zx * x + zy * y + zz * z;
                return Place{ ux * x + uy * y + uz * z, vx * x + vy * y + vz * z, constant - w_slope * depth, depth };
            };
            auto length = [](const Place& e) { return fabs(e.u) + fabs(e.v) + fabs(e.w) + fabs(e.z); };
            auto larger = [](double x, double y) { return x > y ? x : y; };
            auto edge = [&](const Place& a, const Place& e, double sign) {
                const double x = a.v * e.w - a.w * e.v, y = a.w * e.u - a.u * e.w, z = a.u * e.v - a.v * e.u;
                const double inverse = 1.0 / larger(larger(fabs(x), fabs(y)), fabs(z)), unit = sign * inverse;
                return Plane{ x * unit, y * unit, z * unit, setup * (1.0 + length(a)) * length(e) * inverse };
            };
            for (int j = 0; j < n; ++j) {
                const double sign = side[j];
                const Place a = turned(ax[j] - ox, ay[j] - oy, az[j] - oz, w_constant);
                const Place b = turned(bx[j] - ox, by[j] - oy, bz[j] - oz, w_constant);
                const Place c = turned(cx[j] - ox, cy[j] - oy, cz[j] - oz, w_constant);
                corner[0][j] = a.u;
                corner[1][j] = a.v;
                corner[2][j] = a.w;
                corner[3][j] = a.z;
                corner[4][j] = b.u;
                corner[5][j] = b.v;
                corner[6][j] = b.w;
                corner[7][j] = b.z;
                corner[8][j] = c.u;
                corner[9][j] = c.v;
                corner[10][j] = c.w;
                corner[11][j] = c.z;
                const Place ab = turned(bx[j] - ax[j], by[j] - ay[j], bz[j] - az[j], 0.0);
                const Place bc = turned(cx[j] - bx[j], cy[j] - by[j], cz[j] - bz[j], 0.0);
                const Place ca = turned(ax[j] - cx[j], ay[j] - cy[j], az[j] - cz[j], 0.0);
                const Plane p0 = edge(a, ab, sign), p1 = edge(b, bc, sign), p2 = edge(c, ca, sign);
                // (b - a) x (c - a) = (a - c) x (b - a) in (U, V, Z)
                double x = ca.v * ab.z - ca.z * ab.v, y = ca.z * ab.u - ca.u * ab.z, z = ca.u * ab.v - ca.v * ab.u;
                const double inverse = 1.0 / larger(larger(fabs(x), fabs(y)), fabs(z)), flip = -sign * inverse;
                x *= flip;
                y *= flip;
                z *= flip;
                const double d = x * a.u + y * a.v + z * a.z;
                const double error =
                    setup * (fabs(ab.u) + fabs(ab.v) + fabs(ab.z)) * (fabs(ca.u) + fabs(ca.v) + fabs(ca.z)) * inverse;
                const double extent = 1.0 + fabs(a.u) + fabs(a.v) + fabs(a.z);
                record[0][j][0] = p0.x;
                record[0][j][1] = p0.y;
                record[0][j][2] = p0.z;
                record[0][j][3] = rounding + 2.0 * larger(larger(p0.error, p1.error), p2.error);
                record[1][j][0] = p1.x;
                record[1][j][1] = p1.y;
                record[1][j][2] = p1.z;
                record[1][j][3] = slope_factor * u32 + 2.0 * error;
                record[2][j][0] = p2.x;
                record[2][j][1] = p2.y;
                record[2][j][2] = p2.z;
                const double bound = offset_factor * u32 * fabs(d) + 2.0 * (error + setup) * extent;
                record[2][j][3] = fabs(d) < largest_offset ? bound : HUGE_VAL;
                record[3][j][0] = x;
                record[3][j][1] = y;
                record[3][j][2] = z;
                record[3][j][3] = d;
            }
        }
        if (corners.shape[0] > 0) {
            // Lanes behind the last triangle repeat it.
            for (int j = n; j % 16; ++j)
                for (int k = 0; k < 12; ++k)
                    corner[k][j] = corner[k][n - 1];
            for (int j = 0; j < n; j += 16)
                for (int k = 0; k < 12; ++k)
                    memcpy(corners.data + 12 * (size_t)(first_corner + j) + 16 * k, corner[k] + j, 64);
        }
        wp::vec4* __restrict__ out = records.data + 4 * (size_t)first_record;
        for (int j = 0; j < n; ++j)
            for (int k = 0; k < 4; ++k)
                memcpy(out + 4 * j + k, record[k][j], 16);
        if (nothing + front > 0)
            for (int j = 0; j < n; ++j)
                if (side[j] == 0.0)
                    for (int k = 0; k < 4; ++k)
                        out[4 * j + k] = wp::vec4(0.0f, 0.0f, 0.0f, k == 3 ? 1.0f : 0.0f);
    }
};
