// constants: TILE_PAD TILE_QUANTITIES GONE
// What holds some rays of a face: bounds of u, v and t.
struct TileBox {
    enum { SIXTEEN = 16 * TILE_QUANTITIES };
    float low[3], high[3];

    // The first quantity of a box; the next is 16 floats behind.
    static inline float* at(const wp::array_t<float>& boxes, int number) {
        return boxes.data + SIXTEEN * (size_t)(number >> 4) + (number & 15);
    }
    // From now on it fails every test.
    static inline void remove(const wp::array_t<float>& boxes, int number) {
        float* box = at(boxes, number);
        box[32] = box[48] = GONE;
    }
    inline void clear() {
        for (int q = 0; q < 3; ++q) {
            low[q] = 3.0e38f;
            high[q] = -3.0e38f;
        }
    }
    inline void join(const TileBox& other) {
        for (int q = 0; q < 3; ++q) {
            low[q] = other.low[q] < low[q] ? other.low[q] : low[q];
            high[q] = other.high[q] > high[q] ? other.high[q] : high[q];
        }
    }
    // Padded, among its sixteen; without rays, as a box that fails every test.
    inline void store(const wp::array_t<float>& boxes, int number) const {
        float* box = at(boxes, number);
        const bool some = low[0] <= high[0];
        const float pad = TILE_PAD, depth_pad = 0.5 * TILE_PAD, gone = GONE;
        for (int q = 0; q < 2; ++q) {
            box[16 * q] = some ? 0.5f * (low[q] + high[q]) : 0.0f;
            box[16 * (2 + q)] = some ? 0.5f * (high[q] - low[q]) + pad : gone;
        }
        box[64] = some ? low[2] - depth_pad * fabsf(low[2]) : 0.0f;
        box[80] = some ? high[2] + depth_pad * fabsf(high[2]) : 0.0f;
    }
    static inline void put(const wp::array_t<float>& boxes, int number, const wp::vec3& low, const wp::vec3& high) {
        const TileBox it = { { low[0], low[1], low[2] }, { high[0], high[1], high[2] } };
        it.store(boxes, number);
    }
};
