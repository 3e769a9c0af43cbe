// cpu
// needs: exact/determinant.h exact/record.h
// constants: RECORDS_BLOCK GAP_VERTEX
// arguments: LightFrame frame
// First the side the light is on, as Determinant::sign decides it, without contraction; what it leaves open gets the
// exact sign one by one (no permanent is above 1e-15 of NaN, so corners that are not finite are left open, too). Then
// the planes; the filter's bound covers any contraction of them, and one reciprocal in place of several divisions.
struct Records : Determinant {
    static inline void block(int first, int count, const LightFrame& frame, double factor, double slope_factor,
                             double offset_factor, double u32, double setup, double largest_offset,
                             const wp::array_t<wp::vec3d>& vertices, const wp::array_t<wp::vec3i>& triangles,
                             int first_record, const wp::array_t<wp::vec4>& records, int first_corner,
                             const wp::array_t<float>& corners, int cull, int row,
                             const wp::array_t<wp::vec2i>& silent) {
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
        int gaps = 0;
        for (int j = 0; nothing && j < n; ++j)
            gaps += triangles.data[first + j][0] == GAP_VERTEX;
        silent.data[row] = wp::vec2i(nothing - gaps, front);
        const Axes axes = Axes::of(frame);
        const Factors factors = { factor, slope_factor, offset_factor, u32, setup, largest_offset };
        for (int j = 0; j < n; ++j) {
            const Record made =
                Record::of(axes, factors, ax[j], ay[j], az[j], bx[j], by[j], bz[j], cx[j], cy[j], cz[j], side[j]);
            made.store(record[0][j], record[1][j], record[2][j], record[3][j]);
            corner[0][j] = (float)made.a.u;
            corner[1][j] = (float)made.a.v;
            corner[2][j] = (float)made.a.w;
            corner[3][j] = (float)made.a.z;
            corner[4][j] = (float)made.b.u;
            corner[5][j] = (float)made.b.v;
            corner[6][j] = (float)made.b.w;
            corner[7][j] = (float)made.b.z;
            corner[8][j] = (float)made.c.u;
            corner[9][j] = (float)made.c.v;
            corner[10][j] = (float)made.c.w;
            corner[11][j] = (float)made.c.z;
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
                    Record::never((float*)(out + 4 * j));
    }
};
