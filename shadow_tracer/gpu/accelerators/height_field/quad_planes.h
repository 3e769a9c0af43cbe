// cpu
// needs: device/lanes.h@16 accelerators/height_field/chart_ray.h@16
// arguments: Structure structure
// The quads of a node, all of whose corners there are, each between two parallel planes: what there is of it lies
// within `thick` of the plane in the middle, in steps; see height_field.py.
struct QuadPlanes {
    // Of each quad: its middle, and how the plane rises from column to column and from row to row.
    float s[16], t[16], height[16], along_s[16], along_t[16], thick[16];

    // Columns and rows of a node's quads.
    static inline Real16 across() { return Real16{ 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3 }; }
    static inline Real16 down() { return Real16{ 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3 }; }
    // Whether none of the node's quads is beyond the last row or column.
    static inline bool all(const DeviceChart& chart, int row, int column) {
        return row + 4 < chart.rows && column + 4 < chart.columns;
    }
    // Four by four heights.
    static inline Real16 heights(const float* from, int columns) {
        typedef float Four __attribute__((ext_vector_type(4), aligned(4)));
        typedef float Eight __attribute__((ext_vector_type(8), aligned(4)));
        const Four a = *(const Four*)from, b = *(const Four*)(from + columns), c = *(const Four*)(from + 2 * columns),
                   d = *(const Four*)(from + 3 * columns);
        const Eight low = __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7),
                    high = __builtin_shufflevector(c, d, 0, 1, 2, 3, 4, 5, 6, 7);
        return __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    }
    inline QuadPlanes(const Structure& structure, const DeviceChart& chart, const ChartRay16& ray, int row,
                      int column) {
        const int columns = chart.columns;
        const float* from = structure.heights.data + chart.first_height + (size_t)row * columns + column;
        const Real16 a = heights(from, columns), b = heights(from + 1, columns), c = heights(from + columns, columns),
                     d = heights(from + columns + 1, columns);
        const Real16 top = b - a, bottom = d - c, rise = 0.5f * (top + bottom), fall = 0.5f * ((c - a) + (d - b));
        Lanes16::store(s, across() + ((float)column + 0.5f));
        Lanes16::store(t, down() + ((float)row + 0.5f));
        Lanes16::store(height, 0.25f * ((a + b) + (c + d)));
        Lanes16::store(along_s, rise);
        Lanes16::store(along_t, fall);
        Lanes16::store(thick, 0.25f * Lanes16::absolute(bottom - top) + ray.pad[2]
                                  + ray.pad[0] * (Lanes16::absolute(rise) + Lanes16::absolute(fall)));
    }
    // The rays that may meet a quad, as bits: not those that are above it or below it both where they come over it and
    // where they leave. What is not a number compares false: where a corner has no height, all of them may.
    inline int met(const ChartRay16& ray, int quad) const {
        CONTRACTED
        const float middle_s = s[quad], middle_t = t[quad], up = along_s[quad], on = along_t[quad], pad = thick[quad];
        Real16 in = 0.0f, out = 1.0001f;
        ray.enter(0, middle_s, ray.reach[0], in, out);
        ray.enter(1, middle_t, ray.reach[1], in, out);
        const Real16 begin =
            (ray.begin[2] - height[quad]) - up * (ray.begin[0] - middle_s) - on * (ray.begin[1] - middle_t);
        const Real16 rises = ray.span[2] - up * ray.span[0] - on * ray.span[1];
        const Real16 first = begin + in * rises, last = begin + out * rises;
        return Lanes16::bits(~(((first > pad) & (last > pad)) | ((first < -pad) & (last < -pad))));
    }
    // Those of `count` quads, and of the rays that met them, that are left.
    inline int keep(const ChartRay16& ray, int* quads, int* rays, int count) const {
        int kept = 0;
        for (int k = 0; k < count; ++k) {
            rays[kept] = rays[k] & met(ray, quads[k]);
            quads[kept] = quads[k];
            kept += rays[kept] != 0;
        }
        return kept;
    }
};
