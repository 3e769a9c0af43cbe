// needs: accelerators/geometry_image/node.h
// arguments: Image image
struct NodeBox {
    // The box of node `key` of a level above the quads. first: node 0 of that level; below: that of the level below.
    static inline void make(const Image& image, int level, int key, int first, int below,
                            const wp::array_t<float>& boxes) {
        const int count = Order::nodes(image, level - 1);
        float low[3] = { 0.0f, 0.0f, 0.0f }, high[3] = { 0.0f, 0.0f, 0.0f };
        bool some = false;
        for (int child = 4 * key; child < 4 * key + 4 && child < count; ++child) {
            const float* node = boxes.data + Node::FLOATS * ((size_t)below + child);
            if (!Node::some(node))
                continue;
            for (int k = 0; k < 3; ++k) {
                low[k] = !some || node[k] < low[k] ? node[k] : low[k];
                high[k] = !some || node[3 + k] > high[k] ? node[3 + k] : high[k];
            }
            some = true;
        }
        Node::store(boxes.data + Node::FLOATS * ((size_t)first + key), low, high, some);
    }
};
