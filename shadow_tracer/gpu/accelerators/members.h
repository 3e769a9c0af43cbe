// needs: query accelerators/mailboxes.h accelerators/tree_node.h
// Shows a ray the triangles of a cell or leaf.
struct Members {
    // Those from `first` to before `last` that it was not shown just before; true if that was enough.
    static inline bool show(const wp::array_t<int>& members, int first, int last, Mailboxes& mailboxes, Query1& query) {
        for (int k = first; k < last; ++k) {
            const int triangle = members.data[k];
            if (!mailboxes.hold(triangle) && query.visit(triangle))
                return true;
        }
        return false;
    }
    static inline bool show(const wp::array_t<int>& members, const wp::vec2i& leaf, Mailboxes& mailboxes,
                            Query1& query) {
        return show(members, leaf[0], leaf[0] + (leaf[1] >> 2), mailboxes, query);
    }
};
