// arguments: RayTree tree
// constants: BOX_QUANTITIES BOX_GONE BOX_PAD
// Boxes of nodes as they lie in memory; see boxes.py.
struct NodeBox {
    // The first quantity of a node; the next is one group of siblings further.
    static inline float* at(const RayTree& tree, int node, int log_branch) {
        const int branch = 1 << log_branch;
        return tree.boxes.data + (size_t)(node >> log_branch) * BOX_QUANTITIES * branch + (node & (branch - 1));
    }
    // It has no live rays any more.
    static inline void close(float* box, int branch) {
        for (int k = 3; k < 6; ++k)
            box[k * branch] = (float)BOX_GONE;
    }
    // high < low says that it has no rays.
    static inline void store(const RayTree& tree, int node, const wp::vec3& low, const wp::vec3& high, float nearest,
                             float farthest) {
        const int branch = 1 << tree.log_branch;
        float* box = at(tree, node, tree.log_branch);
        if (high[0] < low[0]) {
            for (int k = 0; k < BOX_QUANTITIES; ++k)
                box[k * branch] = 0.0f;
            close(box, branch);
            return;
        }
        for (int k = 0; k < 3; ++k) {
            box[k * branch] = 0.5f * (low[k] + high[k]);
            box[(3 + k) * branch] = 0.5f * (high[k] - low[k]) + (float)BOX_PAD;
        }
        box[6 * branch] = nearest;
        box[7 * branch] = farthest;
    }
};
