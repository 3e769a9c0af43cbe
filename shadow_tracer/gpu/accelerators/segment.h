// needs: query exact/light.h
// arguments: SceneBox structure.box
// constants: BOX_PADDING FAR_AWAY WIDER
// A ray in the box of the scene, in units of its extent; see segment.py.
struct Segment {
    enum { MISSES, MEETS, TOO_FAR };
    wp::vec3 origin, direction;
    // What the low and the high sides of boxes are compared with: the origin, moved as far as rays of the query may be
    // beside this one.
    wp::vec3 above, below;
    float longest;
    double from, to; // where it is in the box

    // What reciprocals are taken of is never so small that they are infinite.
    static inline float away_from_zero(double x) { return fabs(x) < 1.0e-20 ? 1.0e-20f : (float)x; }
    inline void clip(double start, double way, double half) {
        if (fabs(way) < 1.0e-20) {
            if (fabs(start) > half)
                from = 1.0, to = -1.0;
            return;
        }
        const double one = (-half - start) / way, two = (half - start) / way;
        const double near = one < two ? one : two, far = one < two ? two : one;
        from = near > from ? near : from;
        to = far < to ? far : to;
    }
    inline int place(const Query1& query, const SceneBox& box) {
        const wp::vec4d &sample = query.sample(), &light = query.light();
        double start[3], beside[3] = { 0.0, 0.0, 0.0 }, farthest = 0.0;
        for (int k = 0; k < 3; ++k) {
            start[k] = (sample[k] - box.center[k]) * box.inverse_extent;
            if (!(fabs(start[k]) <= FAR_AWAY))
                return TOO_FAR;
            farthest += fabs(start[k]) + box.half[k];
        }
        const wp::vec4d way = LightSide::towards(wp::vec3d(sample[0], sample[1], sample[2]), light);
        from = 0.0;
        to = way[3] * box.inverse_extent;
        if (Query1::SPREADS)
            for (int k = 0; k < 3; ++k)
                beside[k] = WIDER * query.spread()[k] * (light[3] != 0.0 ? box.inverse_extent : farthest);
        for (int k = 0; k < 3; ++k)
            clip(start[k], way[k], box.half[k] + beside[k]);
        if (!(from <= to))
            return MISSES;
        for (int k = 0; k < 3; ++k) {
            origin[k] = (float)(start[k] + way[k] * from);
            direction[k] = away_from_zero(way[k]);
            above[k] = Query1::SPREADS ? origin[k] + (float)beside[k] : origin[k];
            below[k] = Query1::SPREADS ? origin[k] - (float)beside[k] : origin[k];
        }
        longest = holding(to - from);
        return MEETS;
    }
    static inline float holding(double length) { return (float)(length * 1.0001 + BOX_PADDING); }
    // Leaves out what the query has found to be too far off to matter.
    inline void shorten(Query1& query, const SceneBox& box) {
        double metres;
        if (!query.shortened(metres))
            return;
        const double length = metres * box.inverse_extent - from;
        const float nearer = holding(length > 0.0 ? length : 0.0);
        longest = nearer < longest ? nearer : longest;
    }
};
