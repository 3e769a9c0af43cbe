// constants: CHART_STEPS CHART_ROUNDED GAP_VERTEX
// Nodes over four by four boxes: the least and the largest height of each; see charts.py.
struct Nodes {
    enum { SIDE = 4, NONE = 0xFFFF }; // nothing lies between 65535 and 0

    static inline wp::uint32 pack(float low, float high) {
        if (!(low <= high))
            return NONE;
        const float down = floorf(low - (float)CHART_ROUNDED), up = ceilf(high + (float)CHART_ROUNDED);
        const float most = (float)CHART_STEPS;
        const wp::uint32 least = down < 0.0f ? 0 : (wp::uint32)down, last = (wp::uint32)(up > most ? most : up);
        return least | last << 16;
    }
    // Extends `low` and `high` by the corners of a quad, of which `from` is the first; returns whether one has no
    // height.
    static inline int corners(const float* from, int columns, float& low, float& high) {
        const float a = from[0], b = from[1], c = from[columns], d = from[columns + 1];
        low = -extreme(-low, -a, -b, -c, -d);
        high = extreme(high, a, b, c, d);
        return !(a == a && b == b && c == c && d == d);
    }
    static inline float extreme(float x, float a, float b, float c, float d) {
        // NaN compares false: what is not valid moves nothing.
        x = a > x ? a : x;
        x = b > x ? b : x;
        x = c > x ? c : x;
        return d > x ? d : x;
    }
    // first, rows, columns: of the heights; row, column: of the node, whose number is `node`.
    static inline void of_quads(int first, int rows, int columns, int row, int column, int node,
                                const wp::array_t<float>& heights, const wp::array_t<wp::uint32>& nodes) {
        const float* from = heights.data + first;
        for (int k = 0; k < SIDE * SIDE; ++k) {
            const int r = SIDE * row + k / SIDE, c = SIDE * column + k % SIDE;
            float low = (float)HUGE_VAL, high = -low;
            if (r + 1 < rows && c + 1 < columns)
                corners(from + (size_t)r * columns + c, columns, low, high);
            nodes.data[16 * (size_t)node + k] = pack(low, high);
        }
    }
#if !defined(__CUDA_ARCH__)
    typedef float Four __attribute__((ext_vector_type(4), aligned(4)));
    typedef int Whole __attribute__((ext_vector_type(4), aligned(4)));

    static inline Four load(const float* from) { return *(const Four*)from; }
    static inline Four smaller(Four x, Four y) { return x < y ? x : y; }
    static inline Four larger(Four x, Four y) { return x > y ? x : y; }
    // The node over four by four quads that have all their triangles, and all corners a height; false if they do not.
    static inline bool of_whole(const float* from, int columns, const wp::vec3i* triangle, wp::uint32* node) {
        int gaps = 0;
        for (int r = 0; r < SIDE; ++r)
            for (int k = 0; k < 2 * SIDE; ++k)
                gaps |= triangle[2 * (size_t)r * (columns - 1) + k][0] == GAP_VERTEX;
        if (gaps)
            return false;
        Four low[SIDE + 1], high[SIDE + 1], sum = 0.0f;
        for (int r = 0; r <= SIDE; ++r) {
            const Four a = load(from + (size_t)r * columns), b = load(from + (size_t)r * columns + 1);
            low[r] = smaller(a, b);
            high[r] = larger(a, b);
            sum += a + b;
        }
        const float all = sum.x + sum.y + sum.z + sum.w;
        if (!(all == all))
            return false;
        for (int r = 0; r < SIDE; ++r) {
            const Four none = 0.0f, most = (float)CHART_STEPS;
            const Four least = smaller(low[r], low[r + 1]), last = larger(high[r], high[r + 1]);
            const Four down = larger(__builtin_elementwise_floor(least - (float)CHART_ROUNDED), none);
            const Four up = smaller(__builtin_elementwise_ceil(last + (float)CHART_ROUNDED), most);
            *(Whole*)(node + SIDE * r) =
                __builtin_convertvector(down, Whole) | __builtin_convertvector(up, Whole) << 16;
        }
        return true;
    }
#endif
    // As `of_quads`, over the triangles of the quads; `first`, `vertex` and `triangle` are those of the chart. Returns
    // whether a triangle has a corner that has no height.
    static inline int of_triangles(int first, int vertex, int triangle, int rows, int columns, int row, int column,
                                   int node, const wp::array_t<float>& heights, const wp::array_t<wp::vec3i>& triangles,
                                   const wp::array_t<wp::uint32>& nodes) {
        const float* from = heights.data + first;
#if !defined(__CUDA_ARCH__)
        const size_t quad = (size_t)SIDE * row * (columns - 1) + SIDE * column;
        if (SIDE * (row + 1) < rows && SIDE * (column + 1) < columns
            && of_whole(from + (size_t)SIDE * row * columns + SIDE * column, columns,
                        triangles.data + triangle + 2 * quad, nodes.data + 16 * (size_t)node))
            return 0;
#endif
        int lost = 0;
        for (int k = 0; k < SIDE * SIDE; ++k) {
            const int r = SIDE * row + k / SIDE, c = SIDE * column + k % SIDE;
            float low = (float)HUGE_VAL, high = -low;
            const size_t number = triangle + 2 * ((size_t)r * (columns - 1) + c);
            const bool there = r + 1 < rows && c + 1 < columns;
            // A quad with both triangles has all corners.
            if (there && triangles.data[number][0] != GAP_VERTEX && triangles.data[number + 1][0] != GAP_VERTEX)
                lost |= corners(from + (size_t)r * columns + c, columns, low, high);
            else if (there)
                for (int j = 0; j < 6; ++j) {
                    const int corner = triangles.data[number + j / 3][j % 3];
                    if (corner == GAP_VERTEX)
                        continue;
                    const float h = from[corner - vertex];
                    lost |= !(h == h);
                    low = h < low ? h : low;
                    high = h > high ? h : high;
                }
            nodes.data[16 * (size_t)node + k] = pack(low, high);
        }
        return lost;
    }
    // first, rows, columns: of the nodes of the level below.
    static inline void of_nodes(int first, int rows, int columns, int row, int column, int node,
                                const wp::array_t<wp::uint32>& nodes) {
        for (int k = 0; k < SIDE * SIDE; ++k) {
            const int r = SIDE * row + k / SIDE, c = SIDE * column + k % SIDE;
            wp::uint32 low = NONE, high = 0;
            if (r < rows && c < columns) {
                const wp::uint32* from = nodes.data + 16 * ((size_t)first + (size_t)r * columns + c);
                for (int j = 0; j < SIDE * SIDE; ++j) {
                    const wp::uint32 least = from[j] & 0xFFFF, most = from[j] >> 16;
                    low = least < low ? least : low;
                    high = most > high ? most : high;
                }
            }
            nodes.data[16 * (size_t)node + k] = low | high << 16;
        }
    }
};
