// constants: TREE_WIDTH
// The tree with eight children per node, of the binary one; see wide_tree.py.
struct Collapse {
    enum { LOW = 0, HIGH = 3 * TREE_WIDTH, BOUNDS = 6 * TREE_WIDTH, LINKS = 2 * TREE_WIDTH, INNER = 0, NONE = -1 };
    enum { FULL = -1 };
    const wp::BVH tree;
    const wp::array_t<float>& bounds;
    const wp::array_t<int>& links;

    inline bool is_leaf(int node) const { return tree.node_lowers[node].b; }
    inline float area(int node) const {
        const wp::BVHPackedNodeHalf lower = tree.node_lowers[node], upper = tree.node_uppers[node];
        const float x = upper.x - lower.x, y = upper.y - lower.y, z = upper.z - lower.z;
        return x * y + y * z + z * x;
    }
    // The subtrees that become the children of one with that root; returns how many.
    inline int open(int root, int* children) const {
        int n = 1;
        children[0] = root;
        while (n < TREE_WIDTH) {
            int largest = -1;
            float size = -1.0f;
            for (int k = 0; k < n; ++k)
                if (!is_leaf(children[k]) && area(children[k]) > size) {
                    largest = k;
                    size = area(children[k]);
                }
            if (largest < 0)
                break;
            const int opened = children[largest];
            children[largest] = tree.node_lowers[opened].i;
            children[n++] = tree.node_uppers[opened].i;
        }
        return n;
    }
    inline void write(float* bound, int* link, int child, int count) const {
        const wp::BVHPackedNodeHalf lower = tree.node_lowers[child], upper = tree.node_uppers[child];
        const float low[3] = { lower.x, lower.y, lower.z }, high[3] = { upper.x, upper.y, upper.z };
        for (int axis = 0; axis < 3; ++axis) {
            bound[LOW + TREE_WIDTH * axis] = low[axis];
            bound[HIGH + TREE_WIDTH * axis] = high[axis];
        }
        link[0] = lower.b ? (int)lower.i : count;
        link[TREE_WIDTH] = lower.b ? (int)(upper.i - lower.i) : INNER;
    }
    static inline int make(wp::uint64 bvh, const wp::array_t<float>& bounds, const wp::array_t<int>& links) {
        const Collapse it = { wp::bvh_get(bvh), bounds, links };
        const int capacity = links.shape[0] / LINKS;
        // Roots of the subtrees that wait to become nodes stand in the first link of each: it is written only
        // afterwards.
        int count = 1;
        links.data[0] = *it.tree.root;
        for (int node = 0; node < count; ++node) {
            int children[TREE_WIDTH];
            const int n = it.open(links.data[LINKS * (size_t)node], children);
            for (int k = 0; k < TREE_WIDTH; ++k) {
                float* bound = bounds.data + BOUNDS * (size_t)node + k;
                int* link = links.data + LINKS * (size_t)node + k;
                for (int quantity = 0; quantity < 6; ++quantity)
                    bound[TREE_WIDTH * quantity] = 0.0f;
                link[0] = 0;
                link[TREE_WIDTH] = NONE;
                if (k >= n)
                    continue;
                it.write(bound, link, children[k], count);
                if (it.is_leaf(children[k]))
                    continue;
                if (count == capacity)
                    return FULL;
                links.data[LINKS * (size_t)count++] = children[k];
            }
        }
        return count;
    }
};
