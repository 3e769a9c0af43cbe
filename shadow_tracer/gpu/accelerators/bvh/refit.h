// constants: TREE_LANES CORNERS BLOCK_ROWS BOX_PADDING BOX_OUTSIDE COUNT_OF_NODES COUNT_OF_BLOCKS COUNT_OF_WIDE_NODES
// arguments: Tree tree, SceneBox tree.box
// Boxes of blocks and nodes, and the rows of blocks; see build.py.
struct Refit {
    const Tree& tree;

    static inline double least(double x, double y) { return x < y ? x : y; }
    static inline double most(double x, double y) { return x > y ? x : y; }
    static inline void nothing(float* box) {
        for (int k = 0; k < CORNERS; ++k)
            box[k] = BOX_OUTSIDE;
    }
    // The box of a triangle, for the build.
    static inline void triangle(int number, const wp::array_t<wp::vec3d>& vertices,
                                const wp::array_t<wp::vec3i>& triangles, const Tree& tree,
                                const wp::array_t<float>& boxes) {
        double at[9];
        float* box = boxes.data + CORNERS * (size_t)number;
        nothing(box);
        if (corners(tree.box, vertices, triangles.data[number], at))
            for (int k = 0; k < 3; ++k) {
                box[k] = (float)least(least(at[k], at[3 + k]), at[6 + k]);
                box[4 + k] = (float)most(most(at[k], at[3 + k]), at[6 + k]);
            }
    }
    // A triangle in units of the scene's extent around its centre; false if it casts nothing.
    static inline bool corners(const SceneBox& box, const wp::array_t<wp::vec3d>& vertices, const wp::vec3i& triangle,
                               double* at) {
        for (int corner = 0; corner < 3; ++corner) {
            const wp::vec3d& vertex = vertices.data[triangle[corner]];
            if (!wp::isfinite(vertex))
                return false;
            for (int k = 0; k < 3; ++k)
                at[3 * corner + k] = (vertex[k] - box.center[k]) * box.inverse_extent;
        }
        return true;
    }
    static inline void row(float* to, const double* at) {
        double size[3] = { 0.0, 0.0, 0.0 };
        for (int k = 0; k < 3; ++k) {
            const double one = at[3 + k] - at[k], two = at[6 + k] - at[k];
            to[TREE_LANES * k] = (float)at[k];
            to[TREE_LANES * (3 + k)] = (float)one;
            to[TREE_LANES * (6 + k)] = (float)two;
            size[0] += fabs(one), size[1] += fabs(two), size[2] += fabs(two - one);
        }
        to[TREE_LANES * 9] = (float)(1.000001 * most(most(size[0], size[1]), most(size[2], 1.0e-20)));
    }
    // One that is met by nothing: a negative size is within no bound.
    static inline void empty(float* to) {
        for (int k = 0; k < BLOCK_ROWS; ++k)
            to[TREE_LANES * k] = k == BLOCK_ROWS - 1 ? -1.0f : 0.0f;
    }
    static inline void block(int number, int count, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec3i>& triangles, const Tree& tree) {
        const int* members = tree.members.data + TREE_LANES * (size_t)number;
        float* box = tree.corners.data + CORNERS * (size_t)tree.leaves.data[number];
        const bool rows = tree.rows.shape[0] > 0;
        double low[3] = { 2.0, 2.0, 2.0 }, high[3] = { -2.0, -2.0, -2.0 };
        for (int lane = 0; lane < TREE_LANES; ++lane) {
            const int member = members[lane];
            float* to = tree.rows.data + (rows ? TREE_LANES * BLOCK_ROWS * (size_t)number + lane : 0);
            double at[9];
            if (member < 0 || member >= count || !corners(tree.box, vertices, triangles.data[member], at)) {
                if (rows)
                    empty(to);
                continue;
            }
            if (rows)
                row(to, at);
            for (int k = 0; k < 3; ++k) {
                low[k] = least(low[k], least(least(at[k], at[3 + k]), at[6 + k]));
                high[k] = most(high[k], most(most(at[k], at[3 + k]), at[6 + k]));
            }
        }
        nothing(box);
        for (int k = 0; low[0] <= high[0] && k < 3; ++k) {
            box[k] = (float)(low[k] - BOX_PADDING);
            box[4 + k] = (float)(high[k] + BOX_PADDING);
        }
    }
    // From the boxes of the children.
    static inline void node(int number, const Tree& tree) {
        const int* children = tree.children.data + 2 * (size_t)number;
        if (children[0] < 0)
            return;
        const float* one = tree.corners.data + CORNERS * (size_t)children[0];
        const float* two = tree.corners.data + CORNERS * (size_t)children[1];
        float* box = tree.corners.data + CORNERS * (size_t)number;
        // Boxes that hold nothing make no box larger.
        const bool only_one = two[0] == (float)BOX_OUTSIDE, only_two = one[0] == (float)BOX_OUTSIDE;
        for (int k = 0; k < 4; ++k) {
            box[k] = only_one || (!only_two && one[k] < two[k]) ? one[k] : two[k];
            box[4 + k] = only_one || (!only_two && one[4 + k] > two[4 + k]) ? one[4 + k] : two[4 + k];
        }
    }
    // Half of the surface of a node's box.
    static inline double area(int number, const Tree& tree) {
        const float* box = tree.corners.data + CORNERS * (size_t)number;
        const double x = box[4] - box[0], y = box[5] - box[1], z = box[6] - box[2];
        return x * y + y * z + z * x;
    }
    // Adds up all of them.
    static inline void measure(const Tree& tree, const wp::array_t<double>& areas) {
        double sum = 0.0;
        for (int k = 0; k < tree.counts.data[COUNT_OF_NODES]; ++k)
            sum += area(k, tree);
        areas.data[0] = sum;
        areas.data[1] = area(0, tree);
    }
    // All of them in one thread.
    static inline void nodes(const Tree& tree) {
        for (int k = tree.counts.data[COUNT_OF_NODES] - 1; k >= 0; --k)
            node(k, tree);
    }
    static inline void blocks(int count, const wp::array_t<wp::vec3d>& vertices,
                              const wp::array_t<wp::vec3i>& triangles, const Tree& tree) {
        for (int k = 0; k < tree.counts.data[COUNT_OF_BLOCKS]; ++k)
            block(k, count, vertices, triangles, tree);
    }
    // The bounds of nodes with sixteen children.
    static inline void wide_nodes(const Tree& tree) {
        for (int k = 0; k < tree.counts.data[COUNT_OF_WIDE_NODES]; ++k) {
            float* bounds = tree.bounds.data + 6 * TREE_LANES * (size_t)k;
            for (int lane = 0; lane < TREE_LANES; ++lane) {
                const int source = tree.sources.data[TREE_LANES * (size_t)k + lane];
                const float* box = tree.corners.data + CORNERS * (size_t)(source < 0 ? 0 : source);
                for (int axis = 0; axis < 3; ++axis) {
                    bounds[TREE_LANES * axis + lane] = source < 0 ? (float)BOX_OUTSIDE : box[axis];
                    bounds[TREE_LANES * (3 + axis) + lane] = source < 0 ? (float)BOX_OUTSIDE : box[4 + axis];
                }
            }
        }
    }
};
