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
