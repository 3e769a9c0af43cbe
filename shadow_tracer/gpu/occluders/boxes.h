// cpu
// arguments: Clusters clusters
// A comparison with NaN fails, so a corner that is not a number moves nothing; its triangle casts nothing either.
struct ClusterBoxes {
    typedef double Four __attribute__((ext_vector_type(4)));

    // The last number twice: four make a register.
    static inline Four of(const wp::vec3d& p) {
        const Four x = { p[0], p[1], p[2], p[2] };
        return x;
    }
    static inline Four smaller(Four x, Four y) { return x < y ? x : y; }
    static inline Four larger(Four x, Four y) { return x > y ? x : y; }
    static inline void make(int item, const Clusters& clusters, const wp::array_t<wp::vec3d>& vertices,
                            const wp::array_t<wp::vec3i>& triangles) {
        float* box = clusters.boxes.data + 96 * (size_t)item;
        const int count = clusters.triangles;
        for (int lane = 0; lane < 16; ++lane) {
            const int first = 256 * item + 16 * lane, last = first + 16 < count ? first + 16 : count;
            // Of each corner apart, so that none waits for another.
            Four least[3], most[3];
            for (int k = 0; k < 3; ++k) {
                least[k] = 3.0e38;
                most[k] = -3.0e38;
            }
            for (int t = first; t < last; ++t) {
                const wp::vec3i& corners = triangles.data[t];
                for (int k = 0; k < 3; ++k) {
                    const Four p = of(vertices.data[corners[k]]);
                    least[k] = smaller(p, least[k]);
                    most[k] = larger(p, most[k]);
                }
            }
            const Four low = smaller(smaller(least[0], least[1]), least[2]);
            const Four high = larger(larger(most[0], most[1]), most[2]);
            for (int c = 0; c < 3; ++c) {
                const float down = (float)low[c], up = (float)high[c];
                box[16 * c + lane] = down - 0x1p-23f * fabsf(down) - 1.0e-37f;
                box[16 * (3 + c) + lane] = up + 0x1p-23f * fabsf(up) + 1.0e-37f;
            }
        }
    }
};
