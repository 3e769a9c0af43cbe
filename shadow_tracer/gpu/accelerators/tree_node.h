// constants: TREE_LEAF
// Nodes of trees over space, which are pairs of numbers; see references.py.
struct TreeNode {
    static inline bool is_leaf(const wp::vec2i& node) { return (node[1] & 3) == TREE_LEAF; }
    // Of an inner node: what it means is the tree's.
    static inline int kind(const wp::vec2i& node) { return node[1] & 3; }
};
