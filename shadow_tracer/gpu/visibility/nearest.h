// needs: exact/hit.h exact/ray_test.h@1
// The closest triangle on the ray of one pixel, of those that are shown.
struct Nearest : Hit {
    float x, y; // of the ray, (x, -y) of the pixel
    float magnitude;
    int column, row;
    int tests;
    int best;        // the closest triangle so far, -1 for none
    float low, high; // bounds of its inverse depth

    inline Nearest(const CameraRays& rays, const CameraTriangles& seen)
        : Hit(rays, seen), x(0.0f), y(0.0f), magnitude(0.0f), column(0), row(0), tests(0), best(-1), low(0.0f),
          high(0.0f) {}
    // x and y of the pixel's ray as they are defined.
    inline double across() const {
        return rays.tabled ? (double)rays.table.data[(size_t)row * rays.width + column][0] : rays.columns.data[column];
    }
    inline double down() const {
        return rays.tabled ? (double)rays.table.data[(size_t)row * rays.width + column][1] : rays.rows.data[row];
    }
    // Before triangles are shown; `before` has been found already, -1 for nothing.
    inline void look(int of_column, int of_row, int before) {
        column = of_column;
        row = of_row;
        x = (float)across();
        y = -(float)down();
        magnitude = fabsf(x) + fabsf(y) + 2.0f;
        tests = 0;
        best = before;
        low = high = -(float)HUGE_VAL;
        if (before < 0)
            return;
        RayTest1 found;
        found.measure(CameraRecord::at(seen.records, before), x, y, magnitude);
        low = found.low;
        high = found.high;
    }
    // Shows a triangle; true if it is the closest one now.
    inline bool nearer(int triangle) {
        ++tests;
        RayTest1 test;
        if (!test.judge(CameraRecord::at(seen.records, triangle), x, y, magnitude, low, high))
            return false;
        if (!test.closer && !replaces(triangle, best, test.inside, test.low, high, across(), down()))
            return false;
        best = triangle;
        low = test.low;
        high = test.high;
        return true;
    }
    // The depth as it is handed out; where there is nothing NaN, of the same bits everywhere.
    inline float measured() const {
        if (best >= 0)
            return DepthPlane::measured_at(best, across(), down(), rays, seen.planes);
        const int bits = 0x7fc00000;
        float none;
        memcpy(&none, &bits, sizeof none);
        return none;
    }
};
