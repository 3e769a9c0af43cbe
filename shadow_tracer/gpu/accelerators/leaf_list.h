// needs: query accelerators/mailboxes.h
// constants: TREE_LEAF
// Nodes of trees over space, which are pairs of numbers; see references.py.
struct LeafList {
    static inline bool is(const wp::vec2i& node) { return (node[1] & 3) == TREE_LEAF; }
    // Of an inner node: what it means is the tree's.
    static inline int kind(const wp::vec2i& node) { return node[1] & 3; }
    // Shows the triangles of a leaf; true if that was enough.
    static inline bool show(const wp::array_t<int>& members, const wp::vec2i& leaf, Mailboxes& mailboxes,
                            Query1& query) {
        return mailboxes.show(members, leaf[0], leaf[0] + (leaf[1] >> 2), query);
    }
};
