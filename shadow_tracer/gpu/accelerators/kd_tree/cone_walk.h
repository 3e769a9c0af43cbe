// needs: accelerators/half_lines.h accelerators/mailboxes.h accelerators/tree_node.h
// constants: KD_LEVELS CONE_ADDED
// arguments: ConeScene scene
// The triangles of the tree that a cone may meet, nearer cells first, one after the other; see kd_tree.py.
struct ConeWalk : HalfLines {
    const ConeScene& scene;
    double after, wanted; // only what is between matters [m]
    Mailboxes mailboxes;
    int waiting[KD_LEVELS];
    double ins[KD_LEVELS], outs[KD_LEVELS]; // where the cone is in what waits
    int top, number;                        // the next node, below 0 if one that waits is
    double in, out;                         // where the cone is in it
    int member, last;                       // the next triangle of a leaf, or of all
    int spent;                              // nodes visited and triangles shown
    int budget;                             // goes on to `spent`

    inline ConeWalk(const ConeScene& scene, const Cone& cone, double slope, double lean, bool)
        : HalfLines(scene.tree.box, cone, slope, lean), scene(scene), after(0.0), wanted(HUGE_VAL), top(0), number(-1),
          in(0.0), out(0.0), member(0), last(0), spent(0), budget(1 << 30) {
        const wp::vec3d& half = scene.tree.box.half;
        const float box[8] = { (float)-half[0], (float)-half[1], (float)-half[2], 0.0f,
                               (float)half[0],  (float)half[1],  (float)half[2],  0.0f };
        if (everything)
            last = scene.count;
        else if (meets(box, in, out))
            number = 0;
    }
    // From now on only what is on the axis.
    inline void narrow() {
        narrowed = true;
        lean_by(0.0, CONE_ADDED);
    }
    inline bool matters(double from, double to) const { return from <= to && Arithmetic::mul(to, unit) >= after; }
    // The number of the next triangle, -1 at the end.
    inline int next() {
        for (;;) {
            while (member < last) {
                const int triangle = everything ? member++ : scene.tree.members.data[member++];
                if (mailboxes.hold(triangle))
                    continue;
                ++spent;
                return triangle;
            }
            if (spent > budget)
                return -1;
            if (number < 0) {
                if (!top)
                    return -1;
                --top;
                if (Arithmetic::mul(ins[top], unit) > wanted)
                    continue;
                number = waiting[top], in = ins[top], out = outs[top];
            }
            ++spent;
            const wp::vec2i node = scene.tree.nodes.data[number];
            if (TreeNode::is_leaf(node)) {
                member = node[0];
                last = member + (node[1] >> 2);
                number = -1;
                continue;
            }
            split(node);
        }
    }
    // Goes on in the child that the cone is in first; the other one waits.
    inline void split(const wp::vec2i& node) {
        const int axis = TreeNode::kind(node), low = node[1] >> 2;
        float plane;
        memcpy(&plane, &node, sizeof plane);
        const double off = Arithmetic::sub(plane, along(origin, axis));
        double low_in = in, low_out = out, high_in = in, high_out = out;
        below(off, axis, low_in, low_out);
        above(off, axis, high_in, high_out);
        const bool in_low = matters(low_in, low_out), in_high = matters(high_in, high_out);
        const bool low_first = low_in < high_in || (low_in == high_in && off >= 0.0);
        if (in_low && in_high) {
            waiting[top] = low_first ? low + 1 : low;
            ins[top] = low_first ? high_in : low_in;
            outs[top++] = low_first ? high_out : low_out;
        }
        const bool to_low = in_low && (low_first || !in_high);
        number = to_low ? low : in_high ? low + 1 : -1;
        in = to_low ? low_in : high_in;
        out = to_low ? low_out : high_out;
    }
};
