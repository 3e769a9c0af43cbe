// cpu
// needs: device/lanes.h@16 accelerators/height_field/chart_ray.h@16
// Some rays in a chart as one: where the first and the last of them are at any part of their segments; see
// height_field.py.
struct ChartBundle {
    // Bounds of what boxes' low and high sides are compared with, and of the spans, with their reciprocals, and the
    // first times these.
    float above[3], below[3], most[3], least[3], of_most[3], of_least[3], first[3], last[3];
    int flip; // turns the numbers of a node's children so that they come in the order of the rays

    static inline float largest(Real16 x) {
        const auto a = x.lo > x.hi ? x.lo : x.hi;
        const auto b = a.lo > a.hi ? a.lo : a.hi;
        const auto c = b.lo > b.hi ? b.lo : b.hi;
        return c.x > c.y ? c.x : c.y;
    }
    inline ChartBundle(const ChartRay16& ray, int lanes) {
        const Mask16 some = Lanes16::mask(lanes);
        const Real16 none = -(float)HUGE_VAL;
        for (int k = 0; k < 3; ++k) {
            above[k] = largest(some ? ray.begin[k] : none) + ray.pad[k];
            below[k] = -largest(some ? -ray.begin[k] : none) - ray.pad[k];
            most[k] = largest(some ? ray.span[k] : none);
            least[k] = -largest(some ? -ray.span[k] : none);
            // No nearer to zero than what has a reciprocal, and no narrower.
            most[k] = fabsf(most[k]) < 1.0e-20f ? 1.0e-20f : most[k];
            least[k] = fabsf(least[k]) < 1.0e-20f ? -1.0e-20f : least[k];
            of_most[k] = 1.0f / most[k];
            of_least[k] = 1.0f / least[k];
            first[k] = above[k] * of_most[k];
            last[k] = below[k] * of_least[k];
        }
        flip = (most[0] + least[0] < 0.0f ? 3 : 0) | (most[1] + least[1] < 0.0f ? 12 : 0);
    }
    // How many rows or columns apart the rays are.
    inline float wide() const {
        const float across = above[0] - below[0] + most[0] - least[0], down = above[1] - below[1] + most[1] - least[1];
        return across > down ? across : down;
    }
    // The quad that something is over, or the nearest one, along an axis that has so many.
    static inline int quad(float at, int quads) {
        return at > 0.0f ? at < (float)(quads - 1) ? (int)at : quads - 1 : 0;
    }
    // The first and the last quad along an axis that some of the rays may meet.
    inline void among(int k, int quads, int& from, int& to) const {
        from = quad(below[k] + (least[k] < 0.0f ? 1.001f * least[k] : 0.0f), quads);
        to = quad(above[k] + (most[k] > 0.0f ? 1.001f * most[k] : 0.0f), quads);
    }
    // The node, of a level up to `level`, that all quads that some of the rays may meet are under: the smallest one.
    inline void begins(const DeviceChart& chart, int& level, int& row, int& column) const {
        int left, right, first, last;
        among(0, chart.columns - 1, left, right);
        among(1, chart.rows - 1, first, last);
        // Numbers of nodes of level l are those of quads but for the last 2 l + 2 bits.
        while (level > 0 && ((left ^ right) | (first ^ last)) >> 2 * level == 0)
            --level;
        row = first >> 2 * (level + 1);
        column = left >> 2 * (level + 1);
    }
    inline void enter(int k, Real16 low, Real16 high, Real16& in, Real16& out) const {
        CONTRACTED
        const Real16 one = low * of_most[k] - first[k], two = high * of_least[k] - last[k];
        if (most[k] > 0.0f)
            in = in > one ? in : one;
        else
            out = out < one ? out : one;
        if (least[k] > 0.0f)
            out = out < two ? out : two;
        else
            in = in > two ? in : two;
    }
    // Boxes that rays may meet, as bits. column, row: their first ones; size: quads along a side; heights: of each the
    // least, and 65536 times the largest.
    inline int met(Real16 column, Real16 row, float size, Mask16 heights) const {
        const Mask16 low = heights & 0xFFFF, high = heights >> 16 & 0xFFFF;
        Real16 in = 0.0f, out = 1.0001f;
        enter(0, column, column + size, in, out);
        enter(1, row, row + size, in, out);
        enter(2, __builtin_convertvector(low, Real16), __builtin_convertvector(high, Real16), in, out);
        return Lanes16::bits((in <= out) & (low <= high));
    }
};
