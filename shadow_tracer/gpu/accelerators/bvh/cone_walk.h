// needs: exact/cone.h
// constants: CORNERS TREE_LANES LEVELS BOX_PADDING CONE_FAR_AWAY
// arguments: ConeScene scene, SceneBox scene.tree.box
// The triangles of a tree that a cone may meet, nearer boxes first, one after the other; see cones.py.
struct ConeWalk {
    const ConeScene& scene;
    double origin[3], way[3], plus[3], minus[3]; // in units of the scene's extent; inverse slopes of the half-lines
    double longest;                              // along the axis
    double unit;                                 // the scene's extent [m]
    double after, wanted;                        // only what is between matters [m]
    double waiting[LEVELS];                      // where the cone enters
    int nodes[LEVELS];
    int top, block, lane; // the next triangle is that of a lane, or without a tree the one of that number
    int spent;            // nodes visited and triangles shown
    bool everything;

    static inline double steep(double slope) {
        return 1.0 / (Arithmetic::absolute(slope) < 1.0e-20 ? (slope < 0.0 ? -1.0e-20 : 1.0e-20) : slope);
    }
    // lean: of the half-lines, in parts of the distance along the axis, beyond what the cone has.
    inline ConeWalk(const ConeScene& scene, const Cone& cone, double slope, double lean)
        : scene(scene), unit(1.0 / scene.tree.box.inverse_extent), after(0.0), wanted(HUGE_VAL), top(0), block(0),
          lane(TREE_LANES), spent(0), everything(false) {
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
        if (everything)
            lane = 0;
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
            if (!top)
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
};
