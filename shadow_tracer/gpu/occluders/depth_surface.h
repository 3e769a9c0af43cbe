// needs: exact/arithmetic.h
// constants: GAP_VERTEX LARGEST_COORDINATE
// The surface in a depth image: the bits of scene/depth_mesh.py.
struct DepthSurface : Arithmetic {
    // Depth number i of an image of uint16 millimetres (`steps`) or float32 metres.
    static inline double depth(const unsigned char* image, bool steps, size_t i) {
        return steps ? (double)((const wp::uint16*)image)[i] / 1000.0 : (double)((const float*)image)[i];
    }

    static inline bool near(double p, double q, double widest) {
        return (p > 0.0) & (q > 0.0) & (p <= mul(q, widest)) & (q <= mul(p, widest));
    }

    static inline void put(int* triangle, bool there, int a, int b, int c) {
        triangle[0] = there ? a : GAP_VERTEX;
        triangle[1] = there ? b : GAP_VERTEX;
        triangle[2] = there ? c : GAP_VERTEX;
    }

    // Corners of a row, from column `first` on and before column `last`; at the origin where there is none. The ways of
    // rays are a row and, from `down` on, a column, or (`each`) both as many as there are corners.
    static inline void corners(const wp::array_t<wp::uint8>& image, bool steps, int width, int step,
                               const wp::array_t<double>& ways, int down, bool each, int columns, int row, int first,
                               int last, int place, const wp::array_t<wp::vec3d>& to) {
        const size_t begin = (size_t)row * columns, pixel = (size_t)row * step * width;
        const double* across = ways.data + (each ? begin : 0);
        const double* downwards = ways.data + down + (each ? begin : (size_t)row);
        double* out = (double*)(to.data + place + begin);
        // A loop for each kind of image, so that it becomes one of vectors.
        if (!each && step == 1)
            some(image.data, steps, pixel, 1, across, downwards, false, first, last, out);
        else if (!each)
            some(image.data, steps, pixel, step, across, downwards, false, first, last, out);
        else
            some(image.data, steps, pixel, step, across, downwards, true, first, last, out);
    }
    static inline void some(const unsigned char* __restrict__ image, const bool steps, size_t pixel, const int step,
                            const double* __restrict__ across, const double* __restrict__ downwards, const bool each,
                            int first, int last, double* __restrict__ out) {
        for (int c = first; c < last; ++c) {
            const double z = depth(image, steps, pixel + (size_t)c * step);
            const double x = mul(across[c], z), y = mul(downwards[each ? c : 0], z);
            // What is not a number compares false.
            const bool there = (z > 0.0) & (z <= LARGEST_COORDINATE) & (absolute(x) <= LARGEST_COORDINATE)
                               & (absolute(y) <= LARGEST_COORDINATE);
            out[3 * (size_t)c] = there ? x : 0.0;
            out[3 * (size_t)c + 1] = there ? y : 0.0;
            out[3 * (size_t)c + 2] = there ? z : 0.0;
        }
    }

    // The triangles of the cells of a row; its corners are vertices of the mesh that begins at vertex `number`.
    static inline void cells(const wp::array_t<wp::vec3d>& corners, int place, int number, int columns, double widest,
                             int row, int first, int last, int triangle, const wp::array_t<wp::vec3i>& to) {
        const size_t begin = (size_t)row * columns;
        const double* from = (const double*)(corners.data + place + begin);
        int* out = (int*)(to.data + triangle + 2 * (size_t)row * (columns - 1));
        double b = from[3 * (size_t)first + 2], d = from[3 * ((size_t)first + columns) + 2];
        bool right = near(b, d, widest);
        for (int k = first; k < last; ++k) { // no branch: which diagonal is taken is as good as random
            const double a = b, c = d;
            const bool left = right;
            b = from[3 * (size_t)k + 5], d = from[3 * ((size_t)k + columns) + 5];
            right = near(b, d, widest);
            const bool top = near(a, b, widest), bottom = near(c, d, widest);
            const bool falls = near(a, d, widest), rises = near(b, c, widest);
            const bool falling = falls & !(rises & (absolute(sub(a, d)) > absolute(sub(b, c))));
            const bool rising = rises & !falling;
            const int i = number + (int)begin + k, j = i + columns;
            put(out + 6 * (size_t)k, left & ((falling & bottom) | (rising & top)), i, j, falling ? j + 1 : i + 1);
            put(out + 6 * (size_t)k + 3, right & ((falling & top) | (rising & bottom)), falling ? i : i + 1,
                falling ? j + 1 : j, falling ? i + 1 : j + 1);
        }
    }
};
