// needs: accelerators/half_lines.h accelerators/bvh/cone_block.h
// constants: CORNERS TREE_LANES TREE_NONE BLOCK_ROWS LEVELS CONE_ADDED
// arguments: ConeScene scene
// The triangles of a tree that a cone may meet, nearer boxes first, one after the other; see cones.py.
struct ConeWalk : HalfLines {
    const ConeScene& scene;
    double after, wanted; // only what is between matters [m]
#if defined(__CUDA_ARCH__)
    enum { DEPTH = LEVELS, NEAR_BY = 2 };
#else
    // Sixteen children of a node at a time: all but one of each level wait.
    enum { DEPTH = TREE_LANES * (LEVELS + 1), NEAR_BY = 2 };
    float from[3], most[3], least[3]; // as above, in float32
    int lanes, through, covers;       // triangles of the block, as bits; those that may be on the axis, or hide all
    ConeBlock sixteen;
#endif
    double waiting[DEPTH]; // where the cone enters
    int nodes[DEPTH];
    int top, block, lane; // the next triangle is that of a lane, or without a tree the one of that number
    int spent;            // nodes visited and triangles shown
    int budget;           // goes on to `spent`, or one block further

    // together: on the CPU look at sixteen boxes and triangles at a time, in float32, where the apex is near enough.
    inline ConeWalk(const ConeScene& scene, const Cone& cone, double slope, double lean, bool together)
        : HalfLines(scene.tree.box, cone, slope, lean), scene(scene), after(0.0), wanted(HUGE_VAL), top(0), block(0),
          lane(TREE_LANES), spent(0), budget(1 << 30) {
        this->together = together;
        double in;
        begin_together(slope);
        round();
        if (everything)
            lane = 0;
        else if (this->together)
            push(0, 0.0);
        else if (matters(0, in))
            push(0, in);
    }
    inline bool matters(int node, double& in) const {
        double out;
        return meets(scene.tree.corners.data + CORNERS * (size_t)node, in, out) && Arithmetic::mul(out, unit) >= after;
    }
    inline void push(int node, double in) {
        nodes[top] = node;
        waiting[top++] = in;
    }
    // The number of the next triangle, -1 at the end.
    inline int next() {
        const int* children = scene.tree.children.data;
        if (together)
            return next_together();
        if (everything)
            return lane < scene.count ? (++spent, lane++) : -1;
        for (;;) {
            while (lane < TREE_LANES) {
                const int member = scene.tree.members.data[TREE_LANES * (size_t)block + lane++];
                if (member >= 0 && member < scene.count) {
                    ++spent;
                    return member;
                }
            }
            if (!top || spent > budget)
                return -1;
            if (Arithmetic::mul(waiting[--top], unit) > wanted)
                continue;
            const size_t node = nodes[top];
            const int left = children[2 * node], right = children[2 * node + 1];
            ++spent;
            if (left < 0) {
                block = ~left;
                lane = 0;
                continue;
            }
            double near, far;
            const bool one = matters(left, near), two = matters(right, far);
            const bool swapped = one && two && far < near;
            if (swapped)
                push(left, near);
            if (two)
                push(right, far);
            if (one && !swapped)
                push(left, near);
        }
    }
#if defined(__CUDA_ARCH__)
    inline void begin_together(double slope) { together = false; }
    inline void round() {}
    inline void narrow() {
        narrowed = true;
        lean_by(0.0, CONE_ADDED);
        round();
    }
    inline int next_together() { return -1; }
#else
    inline void begin_together(double slope) {
        together = together && !everything && scene.tree.links.shape[0] > 0;
        for (int k = 0; k < 3; ++k) {
            together = together && Arithmetic::absolute(origin[k]) <= NEAR_BY;
            from[k] = (float)origin[k];
        }
        lanes = through = covers = 0;
        if (together)
            sixteen.begin(origin, way, slope, longest);
    }
    inline void round() {
        for (int k = 0; k < 3; ++k) {
            most[k] = (float)plus[k];
            least[k] = (float)minus[k];
        }
    }
    // From now on only what may be on the axis.
    inline void narrow() {
        narrowed = true;
        lanes &= through;
        lean_by(0.0, CONE_ADDED);
        round();
    }
    // The boxes of sixteen children that the cone meets, as bits, and where it enters them.
    inline int enter(const float* bounds, float* in) const {
        typedef ConeBlock::Reals Reals;
        const Reals* low = (const Reals*)bounds;
        Reals first = 0.0f, last = (float)(longest * 1.00001);
        for (int k = 0; k < 3; ++k) {
            const Reals one = (low[k] - from[k]) * most[k], two = (low[3 + k] - from[k]) * least[k];
            if (most[k] > 0.0f)
                first = ConeBlock::most(first, one);
            else
                last = ConeBlock::least(last, one);
            if (least[k] > 0.0f)
                last = ConeBlock::least(last, two);
            else
                first = ConeBlock::most(first, two);
        }
        *(Reals*)in = first;
        return ConeBlock::bits(first <= last);
    }
    inline int next_together() {
        for (;;) {
            while (lanes) {
                // First what may be enough.
                const int at = __builtin_ctz(lanes & through ? lanes & through : lanes);
                covers_it = covers >> at & 1;
                through_it = through >> at & 1;
                lanes &= ~(1 << at);
                const int member = scene.tree.members.data[TREE_LANES * (size_t)block + at];
                if (member >= 0 && member < scene.count) {
                    ++spent;
                    return member;
                }
            }
            if (!top || spent > budget)
                return -1;
            const int node = nodes[--top];
            ++spent;
            if (node < 0) {
                block = ~node;
                lanes =
                    sixteen.possible(scene.tree.rows.data + BLOCK_ROWS * TREE_LANES * (size_t)block, through, covers);
                lanes = narrowed ? through : lanes;
                continue;
            }
            float in[TREE_LANES];
            int met = enter(scene.tree.bounds.data + 6 * TREE_LANES * (size_t)node, in);
            const int* links = scene.tree.links.data + TREE_LANES * (size_t)node;
            const int bottom = top;
            for (; met; met &= met - 1) {
                const int k = __builtin_ctz(met);
                if (links[k] == TREE_NONE)
                    continue;
                int at = top++;
                for (; at > bottom && waiting[at - 1] < in[k]; --at) {
                    waiting[at] = waiting[at - 1];
                    nodes[at] = nodes[at - 1];
                }
                waiting[at] = in[k];
                nodes[at] = links[k];
            }
        }
    }
#endif
};
