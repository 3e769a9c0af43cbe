// needs: query accelerators/segment.h accelerators/members.h
// arguments: Structure structure
// constants: OCTREE_LEVELS OCTREE_HALF
// From child to child of the cells that hold each other (Revelles, Urena, Lastra 2000); see octree.py.
struct Walk1 {
    enum { OCTANT = 7 };
    // The cell that the ray is in, and where it meets the planes through its middle.
    struct Cell {
        wp::vec3 middle, at;
        float half;

        inline void meet(const wp::vec3& origin, const wp::vec3& inverse) {
            for (int k = 0; k < 3; ++k)
                at[k] = (middle[k] - origin[k]) * inverse[k];
        }
        // The next plane, of those that have not been crossed; 3 if none is met before `end`.
        inline int next(int crossed, float& end) const {
            int axis = 3;
            for (int k = 0; k < 3; ++k)
                if (!(crossed >> k & 1) && at[k] <= end) {
                    end = at[k];
                    axis = k;
                }
            return axis;
        }
        inline void into(int octant, float sign) {
            for (int k = 0; k < 3; ++k)
                middle[k] += octant >> k & 1 ? sign * half : -sign * half;
        }
    };

    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::MISSES)
            return;
        if (place == Segment::TOO_FAR) {
            query.everything();
            return;
        }
        wp::vec3 inverse;
        int back = 0; // the axes that the ray goes down
        for (int k = 0; k < 3; ++k) {
            inverse[k] = 1.0f / segment.direction[k];
            back |= segment.direction[k] < 0.0f ? 1 << k : 0;
        }
        Mailboxes mailboxes;
        int open[OCTREE_LEVELS];   // of the cells around: their first child, and the planes that have been crossed
        float ends[OCTREE_LEVELS]; // how far the ray is in them
        Cell cell;
        cell.middle = wp::vec3(0.0f, 0.0f, 0.0f);
        cell.half = (float)OCTREE_HALF;
        int level = 0, number = 0;
        float now = 0.0f, until = segment.longest; // the part of the ray that is in the cell
        for (;;) {
            ++query.nodes;
            const wp::vec2i node = structure.nodes.data[number];
            int crossed = 0;
            if (!TreeNode::is_leaf(node)) {
                cell.meet(segment.origin, inverse);
                for (int k = 0; k < 3; ++k)
                    crossed |= cell.at[k] < now ? 1 << k : 0;
                open[level] = node[1] >> 2 << 3 | crossed;
                ends[level] = until;
                cell.next(crossed, until);
            } else {
                if (Members::show(structure.members, node, mailboxes, query))
                    return;
                segment.shorten(query, structure.box);
                now = until;
                if (!(now <= segment.longest))
                    return;
                // To the innermost cell in which the ray meets another plane.
                for (int axis = 3; axis == 3;) {
                    if (level == 0)
                        return;
                    --level;
                    cell.half *= 2.0f;
                    crossed = open[level] & OCTANT;
                    cell.into(crossed ^ back, -0.5f);
                    cell.meet(segment.origin, inverse);
                    until = ends[level];
                    axis = cell.next(crossed, until);
                    crossed |= axis < 3 ? 1 << axis : 0;
                }
                open[level] = (open[level] & ~OCTANT) | crossed;
                until = ends[level];
                cell.next(crossed, until);
            }
            // To the child behind the planes that have been crossed.
            number = (open[level] >> 3) + (crossed ^ back);
            cell.into(crossed ^ back, 0.5f);
            cell.half *= 0.5f;
            ++level;
        }
    }
};
