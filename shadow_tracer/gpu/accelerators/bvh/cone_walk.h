// needs: exact/cone.h accelerators/bvh/cone_block.h
// constants: CORNERS TREE_LANES TREE_NONE BLOCK_ROWS LEVELS BOX_PADDING CONE_FAR_AWAY CONE_ADDED
// arguments: ConeScene scene, SceneBox scene.tree.box
// The triangles of a tree that a cone may meet, nearer boxes first, one after the other; see cones.py.
struct ConeWalk {
    const ConeScene& scene;
    double origin[3], way[3], plus[3], minus[3]; // in units of the scene's extent; inverse slopes of the half-lines
    double longest;                              // along the axis
    double unit;                                 // the scene's extent [m]
    double after, wanted;                        // only what is between matters [m]
#if defined(__CUDA_ARCH__)
    enum { DEPTH = LEVELS, NEAR_BY = 2 };
#else
    // Sixteen children of a node at a time: all but one of each level wait.
    enum { DEPTH = TREE_LANES * (LEVELS + 1), NEAR_BY = 2 };
    float from[3], most[3], least[3]; // as above, in float32
    int lanes, through, covers;       // triangles of the block, as bits; those that may be on the axis, or hide all
    ConeBlock sixteen;
#endif
    bool together;
    double waiting[DEPTH]; // where the cone enters
    int nodes[DEPTH];
    int top, block, lane; // the next triangle is that of a lane, or without a tree the one of that number
    int spent;            // nodes visited and triangles shown
    bool everything;
    bool narrowed;              // only what may be on the axis matters
    bool covers_it, through_it; // whether the triangle that has come may, or may be on the axis
    int budget;                 // goes on to `spent`, or one block further

    static inline double steep(double slope) {
        return 1.0 / (Arithmetic::absolute(slope) < 1.0e-20 ? (slope < 0.0 ? -1.0e-20 : 1.0e-20) : slope);
    }
    // lean: of the half-lines, in parts of the distance along the axis, beyond what the cone has.
    // together: on the CPU look at sixteen boxes and triangles at a time, in float32, where the apex is near enough.
    inline ConeWalk(const ConeScene& scene, const Cone& cone, double slope, double lean, bool together)
        : scene(scene), unit(1.0 / scene.tree.box.inverse_extent), after(0.0), wanted(HUGE_VAL), together(together),
          top(0), block(0), lane(TREE_LANES), spent(0), everything(false), narrowed(false), covers_it(true),
          through_it(true), budget(1 << 30) {
        const SceneBox& box = scene.tree.box;
        const double at[3] = { cone.apex.x.number, cone.apex.y.number, cone.apex.z.number };
        way[0] = cone.axis.x.number, way[1] = cone.axis.y.number, way[2] = cone.axis.z.number;
        for (int k = 0; k < 3; ++k) {
            origin[k] = Arithmetic::mul(Arithmetic::sub(at[k], box.center[k]), box.inverse_extent);
            everything |= !(Arithmetic::absolute(origin[k]) <= CONE_FAR_AWAY);
        }
        spread(slope, lean);
        longest = cone.length.number * box.inverse_extent + BOX_PADDING;
        double in;
        begin_together(slope);
        if (everything)
            lane = 0;
        else if (this->together)
            push(0, 0.0);
        else if (matters(0, in))
            push(0, in);
    }
    inline void spread(double slope, double lean) {
        for (int k = 0; k < 3; ++k) {
            const double one = way[(k + 1) % 3], two = way[(k + 2) % 3];
            const double aside =
                Arithmetic::mul(slope, sqrt(Arithmetic::add(Arithmetic::mul(one, one), Arithmetic::mul(two, two))));
            plus[k] = steep(Arithmetic::add(way[k], Arithmetic::add(aside, lean)));
            minus[k] = steep(Arithmetic::sub(way[k], Arithmetic::add(aside, lean)));
        }
        round();
    }
    // Whether the boxes of the cone's discs meet a box before `longest`, and from where to where.
    inline bool meets(const float* box, double& in, double& out) const {
        in = 0.0;
        out = longest;
        for (int k = 0; k < 3; ++k) {
            const double low = Arithmetic::mul(Arithmetic::sub(box[k], origin[k]), plus[k]);
            const double high = Arithmetic::mul(Arithmetic::sub(box[4 + k], origin[k]), minus[k]);
            if (plus[k] > 0.0)
                in = low > in ? low : in;
            else
                out = low < out ? low : out;
            if (minus[k] > 0.0)
                out = high < out ? high : out;
            else
                in = high > in ? high : in;
        }
        return in <= out;
    }
    inline bool matters(int node, double& in) const {
        double out;
        return meets(scene.tree.corners.data + CORNERS * (size_t)node, in, out) && Arithmetic::mul(out, unit) >= after;
    }
    // A cone to its end, or without one to where nothing of the scene is any more.
    static inline Cone cone(const ConeScene& scene, const wp::vec3d& from, const wp::vec4d& end, double slope) {
        const Triple to(wp::vec3d(end[0], end[1], end[2]));
        const Triple way = end[3] == 0.0 ? to : to - Triple(from);
        return Cone(from, way, slope, end[3] == 0.0 ? reach(scene, from) : way.length().number);
    }
    // A length [m] beyond which nothing of the scene is.
    static inline double reach(const ConeScene& scene, const wp::vec3d& from) {
        double sum = 0.0;
        for (int k = 0; k < 3; ++k)
            sum = Arithmetic::add(sum, Arithmetic::absolute(Arithmetic::sub(from[k], scene.tree.box.center[k])));
        return Arithmetic::mul(1.001, Arithmetic::add(sum, Arithmetic::mul(4.0, 1.0 / scene.tree.box.inverse_extent)));
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
        spread(0.0, CONE_ADDED);
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
        spread(0.0, CONE_ADDED);
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
