// needs: exact/cone.h
// constants: BOX_PADDING CONE_FAR_AWAY
// arguments: ConeScene scene, SceneBox scene.tree.box
// A cone as the boxes of its discs, in units of the scene's extent; see cones.py. What lies on one side of a plane
// across an axis is a half-line of the distance along the cone's axis.
struct HalfLines {
    double origin[3], way[3], plus[3], minus[3]; // the last two: inverse slopes
    double longest;                              // along the axis
    double unit;                                 // the scene's extent [m]
    bool everything;                             // the apex is too far away
    bool narrowed;                               // only what is on the axis matters
    // Of walks that look at several triangles together, and so leave out what is far off: whether this one does, and
    // whether the triangle that has come may be on the axis, and hide all of the cone.
    bool together, through_it, covers_it;

    static inline double steep(double slope) {
        return 1.0 / (Arithmetic::absolute(slope) < 1.0e-20 ? (slope < 0.0 ? -1.0e-20 : 1.0e-20) : slope);
    }
    // lean: of the half-lines, in parts of the distance along the axis, beyond what the cone has.
    inline HalfLines(const SceneBox& box, const Cone& cone, double slope, double lean)
        : unit(1.0 / box.inverse_extent), everything(false), narrowed(false), together(false), through_it(true),
          covers_it(true) {
        const double at[3] = { cone.apex.x.number, cone.apex.y.number, cone.apex.z.number };
        way[0] = cone.axis.x.number, way[1] = cone.axis.y.number, way[2] = cone.axis.z.number;
        for (int k = 0; k < 3; ++k) {
            origin[k] = Arithmetic::mul(Arithmetic::sub(at[k], box.center[k]), box.inverse_extent);
            everything |= !(Arithmetic::absolute(origin[k]) <= CONE_FAR_AWAY);
        }
        lean_by(slope, lean);
        longest = cone.length.number * box.inverse_extent + BOX_PADDING;
    }
    inline void lean_by(double slope, double lean) {
        for (int k = 0; k < 3; ++k) {
            const double one = way[(k + 1) % 3], two = way[(k + 2) % 3];
            const double aside =
                Arithmetic::mul(slope, sqrt(Arithmetic::add(Arithmetic::mul(one, one), Arithmetic::mul(two, two))));
            plus[k] = steep(Arithmetic::add(way[k], Arithmetic::add(aside, lean)));
            minus[k] = steep(Arithmetic::sub(way[k], Arithmetic::add(aside, lean)));
        }
    }
    // Leaves of the part from `in` to `out` what is not below a plane `off` the apex along an axis, or not above it.
    inline void below(double off, int axis, double& in, double& out) const {
        const double slope = along(minus, axis), t = Arithmetic::mul(off, slope);
        if (slope > 0.0)
            out = t < out ? t : out;
        else
            in = t > in ? t : in;
    }
    inline void above(double off, int axis, double& in, double& out) const {
        const double slope = along(plus, axis), t = Arithmetic::mul(off, slope);
        if (slope > 0.0)
            in = t > in ? t : in;
        else
            out = t < out ? t : out;
    }
    static inline double along(const double (&v)[3], int axis) { return axis == 0 ? v[0] : axis == 1 ? v[1] : v[2]; }
    // Whether the boxes of the cone's discs meet a box before `longest`, and from where to where. A box is four floats
    // of its low corner, the last one nothing, and four of its high one.
    inline bool meets(const float* box, double& in, double& out) const {
        in = 0.0;
        out = longest;
        for (int k = 0; k < 3; ++k) {
            above(Arithmetic::sub(box[k], origin[k]), k, in, out);
            below(Arithmetic::sub(box[4 + k], origin[k]), k, in, out);
        }
        return in <= out;
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
};
