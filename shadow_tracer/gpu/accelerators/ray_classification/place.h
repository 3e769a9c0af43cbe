// needs: query accelerators/segment.h
// arguments: Structure structure
// constants: RAYS_LEVELS ORIGIN_HALF RAY_CHILDREN
// A ray's place in the tree of cells of origins and directions; see ray_classification.py.
struct RayPlace {
    wp::vec3 origin, middle;
    float u, v, middle_u, middle_v, half_origin, half_direction;
    int node;

    // In the cell of all origins, and all directions of a face: 0 to 5 for +x, -x, +y, -y, +z, -z.
    inline explicit RayPlace(const Segment& segment)
        : origin(segment.origin), middle(0.0f, 0.0f, 0.0f), middle_u(0.0f), middle_v(0.0f),
          half_origin((float)ORIGIN_HALF), half_direction(1.0f) {
        const float x = segment.direction[0], y = segment.direction[1], z = segment.direction[2];
        const float along_x = fabsf(x), along_y = fabsf(y), along_z = fabsf(z);
        const int axis = along_x >= along_y && along_x >= along_z ? 0 : along_y >= along_z ? 1 : 2;
        const float major = axis == 0 ? x : axis == 1 ? y : z, size = fabsf(major);
        u = (axis == 0 ? y : axis == 1 ? z : x) / size;
        v = (axis == 0 ? z : axis == 1 ? x : y) / size;
        node = 2 * axis + (major < 0.0f);
    }
    // The half of the cell that it is in, along each of the five.
    inline int code() const {
        int found = 0;
        for (int k = 0; k < 3; ++k)
            found |= origin[k] >= middle[k] ? 1 << k : 0;
        return found | (u >= middle_u ? 8 : 0) | (v >= middle_v ? 16 : 0);
    }
    inline void descend(int code, int child) {
        half_origin *= 0.5f;
        half_direction *= 0.5f;
        for (int k = 0; k < 3; ++k)
            middle[k] += code >> k & 1 ? half_origin : -half_origin;
        middle_u += code & 8 ? half_direction : -half_direction;
        middle_v += code & 16 ? half_direction : -half_direction;
        node = child;
    }
    // To the smallest cell that has a list; returns where in `children` the next smaller one would be, -1 if it is
    // small enough.
    inline int find(const Structure& structure, wp::int64& steps) {
        for (;;) {
            ++steps;
            if (structure.level.data[node] >= RAYS_LEVELS)
                return -1;
            const int way = code(), slot = RAY_CHILDREN * node + way, child = structure.children.data[slot];
            if (child <= 0)
                return slot;
            descend(way, child);
        }
    }
};
