// cpu
// needs: query accelerators/segment.h accelerators/bvh/block.h accelerators/bvh/slabs.h@16
// constants: TREE_LANES TREE_NONE BLOCK_ROWS BLOCK_BAND LEVELS
// arguments: Tree structure
// lanes
// A ray, or a bundle of rays around one, through the tree with sixteen children per node, nearest first; LANES are the
// rays of the query that is shown triangles.
struct WIDE(Descent) {
    // Of each level at most all children but one wait.
    enum { DEPTH = TREE_LANES * (LEVELS + 1), NO_END = 1 << 30 };
    const Tree& tree;
    wp::vec3 origin, direction;
    wp::vec3 inverse;
    wp::vec3 above, below; // see Segment
    float longest;
    float band; // of the triangles of blocks, in parts of their size

    // beside: how far rays of the bundle may be beside this one.
    inline WIDE(Descent)(const Tree& tree, const wp::vec3& origin, const wp::vec3& direction, float longest,
                         float beside)
        : tree(tree), origin(origin), direction(direction),
          inverse(1.0f / direction[0], 1.0f / direction[1], 1.0f / direction[2]),
          above(origin[0] + beside, origin[1] + beside, origin[2] + beside),
          below(origin[0] - beside, origin[1] - beside, origin[2] - beside), longest(longest),
          band((float)BLOCK_BAND + 1.001f * beside) {}
    // Shows those of a block's triangles that may be met; true if that was enough.
    inline bool block(int number, WIDE(Query) & query) const {
        const float* rows = tree.rows.data + BLOCK_ROWS * TREE_LANES * (size_t)number;
        const int* members = tree.members.data + TREE_LANES * (size_t)number;
        for (int found = Block::possible(rows, origin, direction, band, longest); found; found &= found - 1)
            if (query.visit(members[__builtin_ctz(found)]))
                return true;
        return false;
    }
    // segment: for queries that learn how much of the only ray matters.
    // False if more than so many nodes and blocks would have to be visited.
    inline bool go(WIDE(Query) & query, Segment* segment, int budget) {
        float waiting[DEPTH]; // where the ray enters
        int links[DEPTH];
        int top = 1;
        links[0] = 0;
        waiting[0] = 0.0f;
        while (top) {
            const int link = links[--top];
            if (waiting[top] > longest)
                continue;
            ++query.nodes;
            if (!budget--)
                return false;
            if (link < 0) {
                if (block(~link, query))
                    return true;
#if LANES == 1
                segment->shorten(query, tree.box);
                longest = segment->longest;
#endif
                continue;
            }
            const Real16* bounds = (const Real16*)(tree.bounds.data + 6 * TREE_LANES * (size_t)link);
            const int* children = tree.links.data + TREE_LANES * (size_t)link;
            float in[TREE_LANES];
            Slabs16 slabs;
            slabs.enter(bounds, bounds + 3, above, below, inverse, longest);
            Lanes16::store(in, slabs.in);
            const int bottom = top;
            for (int met = slabs.met; met; met &= met - 1) {
                const int k = __builtin_ctz(met), child = children[k];
                if (child == TREE_NONE)
                    continue;
                int at = top++;
                for (; at > bottom && waiting[at - 1] < in[k]; --at) {
                    waiting[at] = waiting[at - 1];
                    links[at] = links[at - 1];
                }
                waiting[at] = in[k];
                links[at] = child;
            }
        }
        return true;
    }
};
