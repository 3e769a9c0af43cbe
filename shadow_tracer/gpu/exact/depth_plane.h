// needs: exact/arithmetic.h exact/canonical.h
// constants: PLANE_COLUMNS
// arguments: CameraRays rays
// Depths from a triangle's plane in float64, in the world: t = D / (N . d), kept between the depths of the corners, so
// that it is sane where the triangle is seen nearly edge-on.
struct DepthPlane : Arithmetic {
    // Columns of a plane, behind N.
    enum { OFFSET = 3, NEAREST = 4, FARTHEST = 5 };

    static inline double along(double n0, double n1, double n2, double x, double y, double z) {
        return add(add(mul(n0, x), mul(n1, y)), mul(n2, z));
    }
    static inline void make(const wp::vec3d& a, const wp::vec3d& b, const wp::vec3d& c, const CameraRays& rays,
                            double* plane) {
        wp::vec3d v[3] = { a, b, c };
        Canonical::sort(v);
        double e[2][3], z[3];
        for (int k = 0; k < 3; ++k) {
            e[0][k] = sub(v[1][k], v[0][k]);
            e[1][k] = sub(v[2][k], v[0][k]);
        }
        const double n0 = sub(mul(e[0][1], e[1][2]), mul(e[0][2], e[1][1]));
        const double n1 = sub(mul(e[0][2], e[1][0]), mul(e[0][0], e[1][2]));
        const double n2 = sub(mul(e[0][0], e[1][1]), mul(e[0][1], e[1][0]));
        plane[0] = n0;
        plane[1] = n1;
        plane[2] = n2;
        for (int k = 0; k < 3; ++k) {
            const double x = sub(v[k][0], rays.position[0]), y = sub(v[k][1], rays.position[1]);
            const double w = sub(v[k][2], rays.position[2]);
            z[k] = along(rays.depth_row[0], rays.depth_row[1], rays.depth_row[2], x, y, w);
            if (k == 0)
                plane[OFFSET] = along(n0, n1, n2, x, y, w);
        }
        const double low = z[0] < z[1] ? z[0] : z[1], high = z[0] < z[1] ? z[1] : z[0];
        const double nearest = low < z[2] ? low : z[2];
        plane[NEAREST] = nearest > 0.0 ? nearest : 0.0;
        plane[FARTHEST] = high > z[2] ? high : z[2];
    }
    // d of the ray through (x, y, 1), one number every `stride`.
    static inline void direction(const CameraRays& rays, double x, double y, double* d, int stride) {
        for (int k = 0; k < 3; ++k)
            d[k * stride] = add(add(mul(rays.right[k], x), mul(rays.down[k], y)), rays.forward[k]);
    }
    // Depth of a hit; NaN becomes the nearest corner's. Plane and d have one number every `stride`.
    static inline double depth(const double* plane, const double* d, int stride) {
        const double size = along(plane[0], plane[stride], plane[2 * stride], d[0], d[stride], d[2 * stride]);
        const double low = plane[NEAREST * stride], high = plane[FARTHEST * stride];
        double t = absolute(plane[OFFSET * stride] / size);
        t = t > low ? t : low;
        return t < high ? t : high;
    }
    // As a measurement: a positive and finite float32, whatever the hit.
    static inline float measured(double t) {
        t = t > 1.0e-37 ? t : 1.0e-37;
        return (float)(t < 3.0e38 ? t : 3.0e38);
    }
    static inline float measured_at(int triangle, double x, double y, const CameraRays& rays,
                                    const wp::array_t<wp::float64>& planes) {
        double d[3];
        direction(rays, x, y, d, 1);
        return measured(depth(planes.data + PLANE_COLUMNS * (size_t)triangle, d, 1));
    }
};
