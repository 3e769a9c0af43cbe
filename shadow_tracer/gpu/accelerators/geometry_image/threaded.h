// needs: visibility/in_place.h accelerators/segment.h accelerators/geometry_image/node.h accelerators/geometry_image/quad.h
// arguments: Structure structure, Image wp::load(structure.images.data)
// Through the boxes of each image in the order of their keys: from a node that is met to its first child, from others
// to what comes after all below them. Both follow from the node's number: there are no links, and no stack.
struct Walk1 {
    static inline float smaller(float x, float y) { return x < y ? x : y; }
    static inline float larger(float x, float y) { return x > y ? x : y; }
    static inline bool met(const float* node, const Segment& ray, const wp::vec3& inverse) {
        float in = 0.0f, out = ray.longest;
        for (int k = 0; k < 3; ++k) {
            const float one = (node[k] - ray.origin[k]) * inverse[k], two = (node[3 + k] - ray.origin[k]) * inverse[k];
            in = larger(in, smaller(one, two));
            out = smaller(out, larger(one, two));
        }
        return in <= out;
    }
    // True if nothing more needs to be shown.
    static inline bool thread(const Structure& structure, const Image& image, const Segment& ray,
                              const wp::vec3& inverse, Query1& query) {
        int level = image.levels - 1, first = image.root;
        wp::uint32 key = 0;
        for (;;) {
            ++query.nodes;
            if (met(structure.boxes.data + Node::FLOATS * ((size_t)first + key), ray, inverse)) {
                if (level > 0) {
                    --level;
                    first -= Order::nodes(image, level);
                    key <<= 2;
                    continue;
                }
                int row, column;
                if (Order::place(image, key, row, column)
                    && Quad::show(query, image.first_triangle + 2 * (row * image.columns + column)))
                    return true;
            }
            ++key;
            if (key << 2 * level >= (wp::uint32)image.keys)
                return false;
            for (; (key & 3) == 0; key >>= 2) {
                first += Order::nodes(image, level);
                ++level;
            }
        }
    }
    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::TOO_FAR)
            query.everything();
        if (place != Segment::MEETS)
            return;
        const wp::vec3 inverse(1.0f / segment.direction[0], 1.0f / segment.direction[1], 1.0f / segment.direction[2]);
        for (int number = 0; number < structure.count; ++number)
            if (thread(structure, structure.images.data[number], segment, inverse, query))
                return;
    }
};
