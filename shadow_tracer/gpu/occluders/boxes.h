// cpu
// arguments: Clusters clusters
// A comparison with NaN fails, so a corner that is not a number moves nothing; its triangle casts nothing either.
struct ClusterBoxes {
    static inline void make(int item, const Clusters& clusters, const wp::array_t<wp::vec3d>& vertices,
                            const wp::array_t<wp::vec3i>& triangles) {
        float* box = clusters.boxes.data + 96 * (size_t)item;
        const int count = clusters.triangles;
        for (int lane = 0; lane < 16; ++lane) {
            const int first = 256 * item + 16 * lane, last = first + 16 < count ? first + 16 : count;
            double low[3] = { 3.0e38, 3.0e38, 3.0e38 }, high[3] = { -3.0e38, -3.0e38, -3.0e38 };
            for (int t = first; t < last; ++t) {
                const wp::vec3i& corners = triangles.data[t];
                for (int k = 0; k < 3; ++k) {
                    const wp::vec3d& p = vertices.data[corners[k]];
                    for (int c = 0; c < 3; ++c) {
                        low[c] = p[c] < low[c] ? p[c] : low[c];
                        high[c] = p[c] > high[c] ? p[c] : high[c];
                    }
                }
            }
            for (int c = 0; c < 3; ++c) {
                const float down = (float)low[c], up = (float)high[c];
                box[16 * c + lane] = down - 0x1p-23f * fabsf(down) - 1.0e-37f;
                box[16 * (3 + c) + lane] = up + 0x1p-23f * fabsf(up) + 1.0e-37f;
            }
        }
    }
};
