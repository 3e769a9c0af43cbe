// A triangle's record as a camera sees it; setup.py has the derivation.
struct CameraRecord {
    // Normals of the three edges, each with a number behind it: the bound s_e of the edges, the bound s_q of the
    // inverse depth, and whether the triangle is there at all; then Q.
    enum { EDGES = 3, EDGE_BOUND = 3, DEPTH_BOUND = 7, CASTS = 11, Q = 12, SIZE = 16 };

    static inline float* at(const wp::array_t<wp::vec4>& records, int triangle) {
        return (float*)records.data + SIZE * (size_t)triangle;
    }
    // Makes it from that of a light, in place.
    static inline void pack(float* record) {
        // Of a light's record.
        enum { N = 12, D = 15, PLANE_BOUND = 7, OFFSET_BOUND = 11 };
        const float n[3] = { record[N], record[N + 1], -record[N + 2] };
        const float d = record[D], s_plane = record[PLANE_BOUND], s_offset = record[OFFSET_BOUND];
        if (n[0] == 0.0f && n[1] == 0.0f && n[2] == 0.0f) {
            for (int k = 0; k < SIZE; ++k)
                record[k] = 0.0f;
            return;
        }
        // Comparisons with NaN fail, and what fails is left to float64.
        float sum = record[EDGE_BOUND];
        for (int k = 0; k < CASTS; ++k)
            sum += (k & 3) == 3 ? 0.0f : (record[k] < 0.0f ? -record[k] : record[k]);
        if (!(sum < 1.0e30f)) {
            for (int k = 0; k < CASTS; ++k)
                record[k] = 0.0f;
            record[EDGE_BOUND] = (float)HUGE_VAL;
        }
        const float inverse = 1.0f / d;
        const bool sure =
            d > 0.0f && s_offset <= 0.25f * d && s_plane <= 0.25f && inverse > 1.0e-30f && inverse < 1.0e30f;
        for (int k = 0; k < 3; ++k)
            record[Q + k] = sure ? n[k] * inverse : 0.0f;
        record[DEPTH_BOUND] = sure ? 2.0f * (s_plane + s_offset * inverse) * inverse : (float)HUGE_VAL;
        record[CASTS] = 1.0f;
        record[SIZE - 1] = 0.0f;
    }
};
