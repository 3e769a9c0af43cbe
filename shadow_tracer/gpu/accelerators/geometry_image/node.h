// needs: accelerators/geometry_image/order.h
// constants: BOX_OUTSIDE
// A node: the low and the high corner of a box; see images.py.
struct Node {
    enum { FLOATS = 6 };

    // Whether there is a quad below.
    static inline bool some(const float* node) { return node[0] <= 1.01f; }
    static inline void store(float* node, const float* low, const float* high, bool some) {
        for (int k = 0; k < 3; ++k) {
            node[k] = some ? low[k] : k == 0 ? (float)BOX_OUTSIDE : 0.0f;
            node[3 + k] = some ? high[k] : k == 0 ? (float)BOX_OUTSIDE : 0.0f;
        }
    }
};
