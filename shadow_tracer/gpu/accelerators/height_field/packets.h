// cpu
// needs: accelerators/height_field/bundle.h accelerators/height_field/quad_planes.h accelerators/height_field/at_chart.h@16
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

    static inline Real16 across() { return QuadPlanes::across(); }
    static inline Real16 down() { return QuadPlanes::down(); }
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
    // The quads of a node that some of the rays may meet, and which rays those are, as bits: first all of their boxes
    // are compared, without a branch for each, which would be taken as often as not.
    static inline int boxes(const ChartRay16& ray, int lanes, int flip, const wp::uint32* leaf, int row, int column,
                            int left, int* quads, int* met) {
        const Mask16 heights = *(const Pairs*)leaf;
        const Real16 low = __builtin_convertvector(heights & 0xFFFF, Real16),
                     high = __builtin_convertvector(heights >> 16 & 0xFFFF, Real16);
        float middle[3][16], half[16];
        Lanes16::store(middle[0], across() + ((float)column + 0.5f));
        Lanes16::store(middle[1], down() + ((float)row + 0.5f));
        Lanes16::store(middle[2], 0.5f * (low + high));
        Lanes16::store(half, 0.5f * (high - low));
        int count = 0;
        for (; left; left &= left - 1) {
            const int quad = __builtin_ctz(left) ^ flip;
            met[count] = lanes & ray.met(middle[0][quad], middle[1][quad], middle[2][quad], half[quad]);
            quads[count] = quad;
            count += met[count] != 0;
        }
        return count;
    }
    // Shows them, in the order of the rays.
    static inline void show(const Structure& structure, const DeviceChart& chart, const ChartRay16& ray, int lanes,
                            int flip, const wp::uint32* leaf, int row, int column, int left, Query16& query) {
        int quads[16], met[16], count = boxes(ray, lanes & query.asking, flip, leaf, row, column, left, quads, met);
        if (count && QuadPlanes::all(chart, row, column))
            count = QuadPlanes(structure, chart, ray, row, column).keep(ray, quads, met, count);
        for (int k = 0; k < count; ++k)
            AtChart16::fetch(chart, row + quads[k] / 4, column + quads[k] % 4, query);
        for (int k = 0; k < count; ++k)
            for (int some = met[k] & query.asking; some; some &= some - 1) {
                query.lane = __builtin_ctz(some);
                AtChart16::show(chart, row + quads[k] / 4, column + quads[k] % 4, query);
            }
    }
    // Until something hides all of them.
    static inline void descend(const Structure& structure, int number, const ChartRay16& ray, int lanes,
                               const ChartBundle& bundle, Query16& query) {
        const auto& chart = structure.charts.data[number];
        const auto* levels = structure.levels.data + CHART_LEVELS * number;
        int top = 0, left[CHART_LEVELS], some = lanes, row, column;
        while (levels[top].rows * levels[top].columns > 1)
            ++top;
        bundle.begins(chart, top, row, column);
        for (int level = top;;) {
            const Level& here = levels[level];
            ++query.nodes;
            left[level] = children(structure, bundle, here.first, here.columns, level, row, column);
            if (level == 0 && left[0]) {
                const size_t node = (size_t)here.first + (size_t)row * here.columns + column;
                show(structure, chart, ray, some, bundle.flip, structure.nodes.data + 16 * node, 4 * row, 4 * column,
                     left[0], query);
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
