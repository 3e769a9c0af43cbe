// cpu
// needs: visibility/mask.h accelerators/segment.h accelerators/bvh/bundle.h@16
// constants: TREE_LANES TREE_NONE LEVELS SHAFT_PLACE WIDER
// arguments: Tree structure
// All that is between some samples and the points of a light (Haines and Wallace 1991: "Shaft Culling for Efficient
// Ray-Traced Radiosity"), through the tree with sixteen children per node; segment.py derives what boxes may be off by.
struct Shaft {
    enum { DEPTH = TREE_LANES * (LEVELS + 1) };
    const Tree& tree;
    BundleSides sides;
    float longest;

    // Whether there is one around a box of samples [m].
    inline bool look(const Query1& query, const wp::vec3d& low, const wp::vec3d& high) {
        const SceneBox& box = tree.box;
        const wp::vec4d& light = query.light();
        const bool finite = light[3] != 0.0;
        for (int k = 0; k < 3; ++k) {
            const double from = (low[k] - box.center[k]) * box.inverse_extent;
            const double to = (high[k] - box.center[k]) * box.inverse_extent;
            if (!(fabs(from) <= SHAFT_PLACE) || !(fabs(to) <= SHAFT_PLACE))
                return false;
            // At a share s of their ways to the points, or at s along ways to infinity, rays are between from +
            // lower s and to + upper s.
            const double spread = WIDER * query.spread()[k] * (finite ? box.inverse_extent : 1.0);
            const double there = finite ? (light[k] - box.center[k]) * box.inverse_extent : light[k];
            sides.upper[k] = (float)to, sides.lower[k] = (float)from;
            sides.upper_inverse[k] = 1.0f / Segment::away_from_zero(there + spread - (finite ? to : 0.0));
            sides.lower_inverse[k] = 1.0f / Segment::away_from_zero(there - spread - (finite ? from : 0.0));
        }
        longest = finite ? Segment::holding(1.0) : 3.0e38f;
        return true;
    }
    // Whether no block is in it of which a triangle casts something.
    inline bool empty(Query1& query) const {
        int links[DEPTH], top = 1;
        links[0] = 0;
        while (top) {
            const int link = links[--top];
            ++query.nodes;
            if (link < 0)
                return false;
            const Real16* bounds = (const Real16*)(tree.bounds.data + 6 * TREE_LANES * (size_t)link);
            const int* children = tree.links.data + TREE_LANES * (size_t)link;
            Bundle16 bundle;
            bundle.enter(bounds, bounds + 3, sides, longest);
            int left = tree.left_out ? bundle.met & tree.casting_nodes.data[link] : bundle.met;
            for (; left; left &= left - 1) {
                const int child = children[__builtin_ctz(left)];
                links[top] = child;
                top += child != TREE_NONE;
            }
        }
        return true;
    }
};
