// needs: exact/cone.h
// constants: CORNERS TREE_LANES TREE_NONE BLOCK_ROWS LEVELS BOX_PADDING CONE_FAR_AWAY CONE_ROUGH
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
    float from[3], slopes[3], most[3], least[3], middle[3], steep_most; // as below, in float32
    int lanes;                                                          // triangles of the block, as bits
#endif
    bool together;
    double waiting[DEPTH]; // where the cone enters
    int nodes[DEPTH];
    int top, block, lane; // the next triangle is that of a lane, or without a tree the one of that number
    int spent;            // nodes visited and triangles shown
    bool everything;
    int budget; // goes on to `spent`, or one block further

    static inline double steep(double slope) {
        return 1.0 / (Arithmetic::absolute(slope) < 1.0e-20 ? (slope < 0.0 ? -1.0e-20 : 1.0e-20) : slope);
    }
    // lean: of the half-lines, in parts of the distance along the axis, beyond what the cone has.
    // together: on the CPU look at sixteen boxes and triangles at a time, in float32, where the apex is near enough.
    inline ConeWalk(const ConeScene& scene, const Cone& cone, double slope, double lean, bool together)
        : scene(scene), unit(1.0 / scene.tree.box.inverse_extent), after(0.0), wanted(HUGE_VAL), together(together),
          top(0), block(0), lane(TREE_LANES), spent(0), everything(false), budget(1 << 30) {
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
        begin_together();
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
        round(slope);
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
    inline void begin_together() { together = false; }
    inline void round(double slope) {}
    inline int next_together() { return -1; }
#else
    inline void begin_together() {
        together = together && !everything && scene.tree.links.shape[0] > 0;
        for (int k = 0; k < 3; ++k) {
            together = together && Arithmetic::absolute(origin[k]) <= NEAR_BY;
            from[k] = (float)origin[k];
        }
        lanes = 0;
    }
    inline void round(double slope) {
        for (int k = 0; k < 3; ++k) {
            most[k] = (float)plus[k];
            least[k] = (float)minus[k];
            middle[k] = (float)way[k];
        }
        steep_most = (float)slope;
    }
    // Where the cone enters sixteen boxes; later than it leaves those that it misses.
    inline void enter(const float* bounds, float* in, float* out) const {
        const float end = (float)(longest * 1.00001);
        for (int k = 0; k < TREE_LANES; ++k) {
            in[k] = 0.0f;
            out[k] = end;
        }
        for (int axis = 0; axis < 3; ++axis) {
            const float* low = bounds + TREE_LANES * axis;
            const float* high = bounds + TREE_LANES * (3 + axis);
            const float one = most[axis], two = least[axis], at = from[axis];
            if (one > 0.0f)
                for (int k = 0; k < TREE_LANES; ++k) {
                    const float t = (low[k] - at) * one;
                    in[k] = t > in[k] ? t : in[k];
                }
            else
                for (int k = 0; k < TREE_LANES; ++k) {
                    const float t = (low[k] - at) * one;
                    out[k] = t < out[k] ? t : out[k];
                }
            if (two > 0.0f)
                for (int k = 0; k < TREE_LANES; ++k) {
                    const float t = (high[k] - at) * two;
                    out[k] = t < out[k] ? t : out[k];
                }
            else
                for (int k = 0; k < TREE_LANES; ++k) {
                    const float t = (high[k] - at) * two;
                    in[k] = t > in[k] ? t : in[k];
                }
        }
    }
    // Those of sixteen triangles that are not far off, as bits: Cone::far_off in float32.
    inline int near_by(const float* rows) const {
        float room[TREE_LANES]; // below zero: far off
        const float band = (float)CONE_ROUGH * (1.0f + steep_most);
        const float vx = middle[0], vy = middle[1], vz = middle[2];
        for (int k = 0; k < TREE_LANES; ++k) {
            const float ax = rows[k] - from[0], ay = rows[TREE_LANES + k] - from[1],
                        az = rows[2 * TREE_LANES + k] - from[2];
            const float bx = ax + rows[3 * TREE_LANES + k], by = ay + rows[4 * TREE_LANES + k],
                        bz = az + rows[5 * TREE_LANES + k];
            const float cx = ax + rows[6 * TREE_LANES + k], cy = ay + rows[7 * TREE_LANES + k],
                        cz = az + rows[8 * TREE_LANES + k];
            const float a = ax * vx + ay * vy + az * vz, b = bx * vx + by * vy + bz * vz,
                        c = cx * vx + cy * vy + cz * vz;
            const float x = ax + bx + cx, y = ay + by + cy, z = az + bz + cz, along = a + b + c;
            const float sx = x - vx * along, sy = y - vy * along, sz = z - vz * along;
            const float wide = steep_most * __builtin_sqrtf(sx * sx + sy * sy + sz * sz);
            const float sizes = fabsf(ax) + fabsf(ay) + fabsf(az) + fabsf(bx) + fabsf(by) + fabsf(bz) + fabsf(cx)
                                + fabsf(cy) + fabsf(cz);
            const float pad = band * (fabsf(x) + fabsf(y) + fabsf(z)) * (0.25f + sizes);
            const float one = sx * ax + sy * ay + sz * az - wide * a, two = sx * bx + sy * by + sz * bz - wide * b,
                        three = sx * cx + sy * cy + sz * cz - wide * c;
            const float lesser = one < two ? one : two;
            room[k] = pad - (lesser < three ? lesser : three);
        }
        int bits = 0;
        for (int k = 0; k < TREE_LANES; ++k) // nothing has a negative size
            bits |= (int)(room[k] >= 0.0f && rows[9 * TREE_LANES + k] >= 0.0f) << k;
        return bits;
    }
    inline int next_together() {
        for (;;) {
            while (lanes) {
                const int at = __builtin_ctz(lanes);
                lanes &= lanes - 1;
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
                lanes = near_by(scene.tree.rows.data + BLOCK_ROWS * TREE_LANES * (size_t)block);
                continue;
            }
            float in[TREE_LANES], out[TREE_LANES];
            enter(scene.tree.bounds.data + 6 * TREE_LANES * (size_t)node, in, out);
            const int* links = scene.tree.links.data + TREE_LANES * (size_t)node;
            const int bottom = top;
            for (int k = 0; k < TREE_LANES; ++k) {
                if (!(in[k] <= out[k]) || links[k] == TREE_NONE)
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
