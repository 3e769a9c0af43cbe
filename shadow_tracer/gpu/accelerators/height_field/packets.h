// cpu
// needs: accelerators/height_field/bundle.h accelerators/height_field/at_chart.h@16
// arguments: Structure structure, Level wp::load(structure.levels.data)
// constants: CHART_LEVELS
// Down the nodes of each chart with sixteen rays at a time: as a bundle against all sixteen children of a node, and
// each for itself against a quad. Rays that lie far apart go down one by one, as bundles of one.
struct Walk16 {
    enum {
        APART = 64, // rows or columns, between rays that go together
        EACH = 1    // level of the last nodes whose children are compared with each of them
    };
    typedef int Pairs __attribute__((ext_vector_type(16), aligned(4)));

    // Columns and rows of a node's children.
    static inline Real16 across() { return Real16{ 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3 }; }
    static inline Real16 down() { return Real16{ 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3 }; }
    // The children of a node that rays may meet, as bits, the first that they come to lowest.
    static inline int children(const Structure& structure, const ChartBundle& bundle, int first, int columns, int level,
                               int row, int column) {
        const int size = 1 << 2 * level;
        const size_t node = (size_t)first + (size_t)row * columns + column;
        const Mask16 heights = *(const Pairs*)(structure.nodes.data + 16 * node);
        int met = bundle.met(across() * (float)size + (float)(4 * column * size),
                             down() * (float)size + (float)(4 * row * size), (float)size, heights);
        if (bundle.flip & 3) {
            met = (met & 0x5555) << 1 | (met >> 1 & 0x5555);
            met = (met & 0x3333) << 2 | (met >> 2 & 0x3333);
        }
        if (bundle.flip & 12) {
            met = (met & 0x0F0F) << 4 | (met >> 4 & 0x0F0F);
            met = (met & 0x00FF) << 8 | met >> 8;
        }
        return met;
    }
    // The rays at those quads of a node that some of them may meet, as bits in their order: first all of these are
    // compared, without a branch for each, which would be taken as often as not.
    static inline void show(const DeviceChart& chart, const ChartRay16& ray, int lanes, int flip,
                            const wp::uint32* leaf, int row, int column, int left, Query16& query) {
        const Mask16 heights = *(const Pairs*)leaf;
        const Real16 low = __builtin_convertvector(heights & 0xFFFF, Real16),
                     high = __builtin_convertvector(heights >> 16 & 0xFFFF, Real16);
        const Real16 middle[3] = { across() + ((float)column + 0.5f), down() + ((float)row + 0.5f),
                                   0.5f * (low + high) };
        const Real16 half = 0.5f * (high - low);
        int met[16], place[16], count = 0;
        for (lanes &= query.asking; left; left &= left - 1) {
            const int child = __builtin_ctz(left) ^ flip;
            met[count] = lanes & ray.met(middle[0][child], middle[1][child], middle[2][child], half[child]);
            place[count] = child;
            if (met[count])
                AtChart16::fetch(chart, row + child / 4, column + child % 4, query);
            count += met[count] != 0;
        }
        for (int k = 0; k < count; ++k)
            for (int some = met[k] & query.asking; some; some &= some - 1) {
                query.lane = __builtin_ctz(some);
                AtChart16::show(chart, row + place[k] / 4, column + place[k] % 4, query);
            }
    }
    // Until something hides all of them.
    static inline void descend(const Structure& structure, int number, const ChartRay16& ray, int lanes,
                               const ChartBundle& bundle, Query16& query) {
        const auto& chart = structure.charts.data[number];
        const auto* levels = structure.levels.data + CHART_LEVELS * number;
        int top = 0, left[CHART_LEVELS], some = lanes, row = 0, column = 0;
        while (levels[top].rows * levels[top].columns > 1)
            ++top;
        for (int level = top;;) {
            const Level& here = levels[level];
            ++query.nodes;
            left[level] = children(structure, bundle, here.first, here.columns, level, row, column);
            if (level == 0 && left[0]) {
                const size_t node = (size_t)here.first + (size_t)row * here.columns + column;
                show(chart, ray, some, bundle.flip, structure.nodes.data + 16 * node, 4 * row, 4 * column, left[0],
                     query);
                if (!(lanes & query.asking))
                    return;
                left[0] = 0;
            }
            int child, met;
            do {
                for (; !left[level]; ++level) {
                    if (level == top)
                        return;
                    row >>= 2;
                    column >>= 2;
                }
                child = __builtin_ctz(left[level]) ^ bundle.flip;
                left[level] &= left[level] - 1;
                met = lanes & query.asking;
                if (level <= EACH) {
                    const size_t node = (size_t)levels[level].first + (size_t)row * levels[level].columns + column;
                    met &= ray.met(4 * column + child % 4, 4 * row + child / 4, level,
                                   structure.nodes.data[16 * node + child]);
                }
            } while (!met);
            some = met;
            row = 4 * row + child / 4;
            column = 4 * column + child % 4;
            --level;
        }
    }
    static inline void walk(const Structure& structure, Query16& query) {
        for (int number = 0; number < structure.count && query.asking; ++number) {
            ChartRay16 ray;
            int lanes = AtChart16::come(structure, number, ray, query);
            if (!lanes)
                continue;
            const ChartBundle bundle(ray, lanes);
            if (bundle.wide() <= (float)APART) {
                descend(structure, number, ray, lanes, bundle, query);
                continue;
            }
            for (; lanes; lanes &= lanes - 1) {
                const int one = lanes & -lanes;
                descend(structure, number, ray, one, ChartBundle(ray, one), query);
            }
        }
    }
};
