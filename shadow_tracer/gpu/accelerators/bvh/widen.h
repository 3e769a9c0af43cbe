// cpu
// constants: TREE_LANES CORNERS TREE_NONE COUNT_OF_WIDE_NODES
// arguments: Tree tree
// Makes nodes with up to sixteen children, the largest opened first; see build.py.
struct Widen {
    const Tree& tree;

    inline bool inner(int node) const { return tree.children.data[2 * (size_t)node] >= 0; }
    inline float area(int node) const {
        const float* box = tree.corners.data + CORNERS * (size_t)node;
        const float x = box[4] - box[0], y = box[5] - box[1], z = box[6] - box[2];
        return x * y + y * z + z * x;
    }
    // The nodes below one that become the children of one with that root; returns how many.
    inline int open(int root, int* children) const {
        float areas[TREE_LANES]; // negative if it cannot be opened
        int n = 1;
        children[0] = root;
        areas[0] = inner(root) ? 1.0f : -1.0f;
        while (n < TREE_LANES) {
            int largest = 0;
            for (int k = 1; k < n; ++k)
                largest = areas[k] > areas[largest] ? k : largest;
            if (areas[largest] < 0.0f)
                break;
            const int* pair = tree.children.data + 2 * (size_t)children[largest];
            children[largest] = pair[0];
            children[n] = pair[1];
            areas[largest] = inner(pair[0]) ? area(pair[0]) : -1.0f;
            areas[n] = inner(pair[1]) ? area(pair[1]) : -1.0f;
            ++n;
        }
        return n;
    }
    static inline void whole(const Tree& tree) {
        const Widen it = { tree };
        // Roots of what waits to become a node stand in its first source, until it is made.
        int count = 1;
        tree.sources.data[0] = 0;
        for (int node = 0; node < count; ++node) {
            int children[TREE_LANES];
            const int n = it.open(tree.sources.data[TREE_LANES * (size_t)node], children);
            for (int k = 0; k < TREE_LANES; ++k) {
                const size_t at = TREE_LANES * (size_t)node + k;
                tree.sources.data[at] = k < n ? children[k] : -1;
                tree.links.data[at] = TREE_NONE;
                if (k >= n)
                    continue;
                tree.links.data[at] = tree.children.data[2 * (size_t)children[k]];
                if (!it.inner(children[k]))
                    continue;
                tree.links.data[at] = count;
                tree.sources.data[TREE_LANES * (size_t)count++] = children[k];
            }
        }
        tree.counts.data[COUNT_OF_WIDE_NODES] = count;
    }
};
