// needs: query exact/light.h accelerators/segment.h
// constants: WIDER STEEPEST
// arguments: SceneBox structure.box
// A bundle of rays from a sample, around a segment: where its upper and lower sides begin, and one over how fast these
// go along the segment; see segment.py. Of queries about single rays nothing.
struct BundleSides {
    wp::vec3 upper, lower, upper_inverse, lower_inverse;

    inline BundleSides() {}
    inline BundleSides(const Query1& query, const Segment& segment, const SceneBox& box) {
        if (!Query1::SPREADS)
            return;
        const wp::vec4d &sample = query.sample(), &light = query.light();
        const wp::vec4d way = LightSide::towards(wp::vec3d(sample[0], sample[1], sample[2]), light);
        for (int k = 0; k < 3; ++k) {
            const double start = (sample[k] - box.center[k]) * box.inverse_extent, at = start + way[k] * segment.from;
            const double faster = WIDER * query.spread()[k] / (light[3] != 0.0 ? way[3] : 1.0);
            // A sample in the middle of the light: its rays are of any direction.
            const bool cone = faster < STEEPEST;
            upper[k] = cone ? (float)(at + faster * segment.from) : segment.above[k];
            lower[k] = cone ? (float)(at - faster * segment.from) : segment.below[k];
            upper_inverse[k] = 1.0f / (cone ? Segment::away_from_zero(way[k] + faster) : segment.direction[k]);
            lower_inverse[k] = 1.0f / (cone ? Segment::away_from_zero(way[k] - faster) : segment.direction[k]);
        }
    }
};
