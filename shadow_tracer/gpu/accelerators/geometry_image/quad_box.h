// needs: accelerators/geometry_image/node.h
// arguments: Image image, SceneBox box
// constants: BOX_PADDING
struct QuadBox {
    // The box of the quad that a key is of: padded, relative to the scene's centre, rounded outwards; none if fewer
    // than three of its texels are valid.
    static inline void make(const Image& image, const SceneBox& box, int key, const wp::array_t<wp::vec3d>& vertices,
                            const wp::array_t<float>& boxes) {
        float* node = boxes.data + Node::FLOATS * ((size_t)image.first_node + key);
        float least[3] = { 0.0f, 0.0f, 0.0f }, most[3] = { 0.0f, 0.0f, 0.0f };
        int valid = 0, row, column;
        if (Order::place(image, (wp::uint32)key, row, column)) {
            const int across = image.columns + 1;
            const wp::vec3d* from = vertices.data + image.first_vertex + (size_t)row * across + column;
            double low[3] = { HUGE_VAL, HUGE_VAL, HUGE_VAL }, high[3] = { -HUGE_VAL, -HUGE_VAL, -HUGE_VAL };
            for (int j = 0; j < 4; ++j) {
                const wp::vec3d& at = from[(j >> 1) * across + (j & 1)];
                if (!wp::isfinite(at))
                    continue;
                ++valid;
                for (int k = 0; k < 3; ++k) {
                    low[k] = at[k] < low[k] ? at[k] : low[k];
                    high[k] = at[k] > high[k] ? at[k] : high[k];
                }
            }
            for (int k = 0; k < 3; ++k) {
                least[k] = (float)((low[k] - box.center[k]) * box.inverse_extent - BOX_PADDING);
                most[k] = (float)((high[k] - box.center[k]) * box.inverse_extent + BOX_PADDING);
            }
        }
        Node::store(node, least, most, valid >= 3);
    }
};
