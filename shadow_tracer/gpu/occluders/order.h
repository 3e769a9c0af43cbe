// cpu
// An order of a mesh's triangles and vertices in which neighbours follow each other; see order.py.
struct MeshOrder {
    // Every third bit of ten.
    static inline int spread_bits(int x) {
        x = (x | x << 16) & 0x030000FF;
        x = (x | x << 8) & 0x0300F00F;
        x = (x | x << 4) & 0x030C30C3;
        return (x | x << 2) & 0x09249249;
    }
    // One of 2^20 cells.
    static inline int cell(double sum, double low, double cells) {
        const double at = (sum / 3.0 - low) * cells, last = (double)((1 << 20) - 1);
        return at > 0.0 ? (at < last ? (int)at : (int)last) : 0; // what is not a number is first
    }
    // Places on Morton's curve of the cells that the centroids of the triangles `numbers` lie in, a million along the
    // longest side from `low` on: `shift` is 0 for the lower half of its bits, 10 for the upper half.
    static inline void make_keys(int count, int shift, const wp::vec3d& low, double cells,
                                 const wp::array_t<wp::vec3d>& vertices, const wp::array_t<wp::vec3i>& triangles,
                                 const wp::array_t<int>& numbers, const wp::array_t<int>& keys) {
        for (int t = 0; t < count; ++t) {
            const wp::vec3i& corner = triangles.data[numbers.data[t]];
            const wp::vec3d &a = vertices.data[corner[0]], &b = vertices.data[corner[1]], &c = vertices.data[corner[2]];
            int key = 0;
            for (int k = 0; k < 3; ++k)
                key |= spread_bits(cell(a[k] + b[k] + c[k], low[k], cells) >> shift & 1023) << k;
            keys.data[t] = key;
        }
    }
    // The sum, over groups of `group` triangles that follow each other in the order `numbers`, of the square roots of
    // half the surface of the box around each.
    static inline double looseness(int count, int group, const wp::array_t<wp::vec3d>& vertices,
                                   const wp::array_t<wp::vec3i>& triangles, const wp::array_t<int>& numbers) {
        double sum = 0.0;
        for (int first = 0; first < count; first += group) {
            double low[3] = { HUGE_VAL, HUGE_VAL, HUGE_VAL }, high[3] = { -HUGE_VAL, -HUGE_VAL, -HUGE_VAL };
            for (int t = first; t < first + group && t < count; ++t)
                for (int j = 0; j < 3; ++j) {
                    const wp::vec3d& p = vertices.data[triangles.data[numbers.data[t]][j]];
                    for (int k = 0; k < 3; ++k) { // what is not a number compares false
                        low[k] = p[k] < low[k] ? p[k] : low[k];
                        high[k] = p[k] > high[k] ? p[k] : high[k];
                    }
                }
            const double x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
            if (x >= 0.0 && y >= 0.0 && z >= 0.0)
                sum += sqrt(x * y + y * z + z * x);
        }
        return sum;
    }
    // The triangles in the order `numbers`, of vertices that are numbered anew as they come: `order` is which each was.
    // Vertices of no triangle come last.
    static inline void arrange(int count, int vertex_count, const wp::array_t<wp::vec3i>& triangles,
                               const wp::array_t<int>& numbers, const wp::array_t<int>& names,
                               const wp::array_t<int>& order, const wp::array_t<wp::vec3i>& arranged) {
        for (int v = 0; v < vertex_count; ++v)
            names.data[v] = -1;
        int next = 0;
        for (int t = 0; t < count; ++t)
            for (int j = 0; j < 3; ++j) {
                const int corner = triangles.data[numbers.data[t]][j];
                if (names.data[corner] < 0) {
                    names.data[corner] = next;
                    order.data[next++] = corner;
                }
                arranged.data[t][j] = names.data[corner];
            }
        for (int v = 0; v < vertex_count; ++v)
            if (names.data[v] < 0)
                order.data[next++] = v;
    }
};
