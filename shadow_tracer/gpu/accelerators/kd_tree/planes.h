// needs: query accelerators/segment.h accelerators/members.h
// arguments: Structure structure
// constants: KD_LEVELS
// Nearer child first, the other one waits on a stack; see kd_tree.py.
struct Walk1 {
    static inline float along(const wp::vec3& v, int axis) { return axis == 0 ? v[0] : axis == 1 ? v[1] : v[2]; }

    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::MISSES)
            return;
        if (place == Segment::TOO_FAR) {
            query.everything();
            return;
        }
        const wp::vec3 inverse(1.0f / segment.direction[0], 1.0f / segment.direction[1], 1.0f / segment.direction[2]);
        Mailboxes mailboxes;
        int waiting[KD_LEVELS];
        float ends[KD_LEVELS]; // how far the ray is in what waits; it begins where what comes before ends
        int top = 0, number = 0;
        float now = 0.0f, until = segment.longest; // the part of the ray that is in the node
        for (;;) {
            ++query.nodes;
            const wp::vec2i node = structure.nodes.data[number];
            if (!TreeNode::is_leaf(node)) {
                const int axis = TreeNode::kind(node);
                float plane;
                memcpy(&plane, &node, sizeof plane);
                const float at = (plane - along(segment.origin, axis)) * along(inverse, axis);
                const int low = node[1] >> 2, forth = along(segment.direction, axis) > 0.0f;
                const int near = forth ? low : low + 1, far = forth ? low + 1 : low;
                if (at >= now && at <= until) {
                    waiting[top] = far;
                    ends[top++] = until;
                    number = near;
                    until = at;
                } else {
                    number = at >= now ? near : far;
                }
                continue;
            }
            if (Members::show(structure.members, node, mailboxes, query))
                return;
            segment.shorten(query, structure.box);
            now = until;
            if (top == 0 || !(now <= segment.longest))
                return;
            number = waiting[--top];
            until = ends[top] < segment.longest ? ends[top] : segment.longest;
        }
    }
};
