// needs: exact/determinant.h exact/depth_plane.h
// constants: PLANE_COLUMNS COUNTER_ROWS CAMERA_TESTS CAMERA_RETESTED CAMERA_EXACT CAMERA_COMPARED
// arguments: CameraRays rays, CameraTriangles seen
// What float32 leaves open, in float64: whether a ray meets a triangle, exactly, and which of two triangles is closer.
struct Hit : Determinant {
    const CameraRays& rays;
    const CameraTriangles& seen;
    int retested, compared, exact_used; // exact_used: determinants that needed expansion arithmetic

    inline Hit(const CameraRays& rays, const CameraTriangles& seen)
        : rays(rays), seen(seen), retested(0), compared(0), exact_used(0) {}
    inline bool meets(int triangle, const double (&d)[3]) {
        const wp::vec3i& corner = seen.triangles.data[triangle];
        const wp::vec3d v[3] = { seen.vertices.data[corner[0]], seen.vertices.data[corner[1]],
                                 seen.vertices.data[corner[2]] };
        const wp::vec3d o = rays.position;
        int facing = 0;
        // One call in a loop that stays a loop, or compilers inline the expansion arithmetic four times.
#pragma unroll 1
        for (int question = 0; question < 4; ++question) {
            const int k = question == 0 ? 0 : question - 1;
            const wp::vec4d q = question == 0 ? wp::vec4d(o[0], o[1], o[2], 1.0) : wp::vec4d(d[0], d[1], d[2], 0.0);
            const wp::vec3d r = question == 0 ? v[1] : o, s = question == 0 ? v[2] : v[(k + 1) % 3];
            double value;
            const int side = sign(q, r, s, v[k], value, exact_used);
            if (question == 0)
                facing = side;
            if (question == 0 ? side == 0 : side * facing < 0)
                return false;
        }
        return true;
    }
    inline double depth(int triangle, const double (&d)[3]) const {
        return DepthPlane::depth(seen.planes.data + PLANE_COLUMNS * (size_t)triangle, d, 1);
    }
    // Whether the ray through (x, y, 1) meets a triangle, and before `other`, -1 for none. What float32 knows: inside,
    // whether it surely does; low, the least inverse depth of the triangle; most, the largest of the other.
    inline bool replaces(int triangle, int other, bool inside, float low, float most, double x, double y) {
        double d[3];
        DepthPlane::direction(rays, x, y, d, 1);
        if (!inside) {
            ++retested;
            if (!meets(triangle, d))
                return false;
        }
        if (low > most || other < 0)
            return true;
        ++compared;
        const double mine = depth(triangle, d), before = depth(other, d);
        return mine < before || (mine == before && triangle < other);
    }
    inline void report(int number, wp::int64 tests, const wp::array_t<wp::int64>& counters) const {
        wp::int64* row = counters.data + (size_t)counters.shape[1] * (number % COUNTER_ROWS);
        wp::atomic_add(row + CAMERA_TESTS, tests);
        if (retested > 0)
            wp::atomic_add(row + CAMERA_RETESTED, (wp::int64)retested);
        if (exact_used > 0)
            wp::atomic_add(row + CAMERA_EXACT, (wp::int64)exact_used);
        if (compared > 0)
            wp::atomic_add(row + CAMERA_COMPARED, (wp::int64)compared);
    }
};
