// constants: TREE_LANES FEWEST CORNERS RULED LEVELS COUNT_OF_NODES COUNT_OF_BLOCKS RULE_SAH RULE_MEDIAN
// arguments: Tree tree, Sorting sorting
// Splits nodes top down until a block holds their triangles; see build.py.
struct Build {
    enum { BINS = 16, AXES = 3, DIGIT = 4, DIGITS = 1 << DIGIT, KEY_BITS = 32 };
    const Tree& tree;
    const Sorting& sorting;

    struct Box {
        float low[4], high[4];

        inline void clear() {
            for (int k = 0; k < 4; ++k)
                low[k] = 3.0e38f, high[k] = -3.0e38f;
        }
        inline void grow(const float* least, const float* most) {
            for (int k = 0; k < 4; ++k) {
                low[k] = least[k] < low[k] ? least[k] : low[k];
                high[k] = most[k] > high[k] ? most[k] : high[k];
            }
        }
        inline float area() const {
            const float x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
            return x * y + y * z + z * x;
        }
    };
    // Where triangles begin, by twice their boxes' middles.
    struct Middles {
        float low[AXES], per_unit[AXES];
    };
    // Low and high corner of the box of a triangle, and 0 after each.
    inline const float* box(int triangle) const { return sorting.boxes.data + CORNERS * (size_t)triangle; }
    inline float middle(int triangle, int axis) const { return box(triangle)[axis] + box(triangle)[4 + axis]; }
    inline int bin(const Middles& middles, int triangle, int axis) const {
        const int k = (int)((middle(triangle, axis) - middles.low[axis]) * middles.per_unit[axis]);
        return k < 0 ? 0 : k >= BINS ? BINS - 1 : k;
    }
    inline Box around_middles(int first, int count) const {
        Box around;
        around.clear();
        for (int k = first; k < first + count; ++k) {
            const float* at = box(sorting.order.data[k]);
            const float twice[4] = { at[0] + at[4], at[1] + at[5], at[2] + at[6], 0.0f };
            around.grow(twice, twice);
        }
        return around;
    }
    static inline int blocks(int count) { return (count + TREE_LANES - 1) / TREE_LANES; }
    // Half of the blocks, all of them full; or all but a block of the fewest.
    static inline int half(int count) {
        const int left = blocks(count) / 2 * TREE_LANES;
        return count - left < FEWEST ? count - FEWEST : left;
    }
    static inline bool enough(int left, int count) { return left >= FEWEST && count - left >= FEWEST; }

    // Which triangles are to be in front: those in bins before one, with keys less than one, or equal to it.
    struct Front {
        enum { BINS_BEFORE, LESS, EQUAL };
        int what, axis, before;
        Middles middles;
        unsigned key;

        inline bool holds(const Build& build, int triangle) const {
            if (what == BINS_BEFORE)
                return build.bin(middles, triangle, axis) < before;
            const unsigned bits = build.key(triangle, axis);
            return what == LESS ? bits < key : bits == key;
        }
    };
    // Moves them there; returns how many they are.
    inline int part(int first, int last, const Front& front) const {
        int* order = sorting.order.data;
        int low = first, high = last - 1;
        for (;;) {
            while (low <= high && front.holds(*this, order[low]))
                ++low;
            while (low < high && !front.holds(*this, order[high]))
                --high;
            if (low >= high)
                return low - first;
            const int swapped = order[low];
            order[low++] = order[high];
            order[high--] = swapped;
        }
    }
    // The surface area heuristic over bins of middles: what a ray has to test of either side, in blocks.
    inline int by_area(int first, int count) const {
        const Box around = around_middles(first, count);
        Middles middles;
        for (int axis = 0; axis < AXES; ++axis) {
            const float wide = around.high[axis] - around.low[axis];
            middles.low[axis] = around.low[axis];
            middles.per_unit[axis] = wide > 0.0f ? BINS * 0.9999f / wide : 0.0f;
        }
        Box bins[AXES][BINS];
        int counts[AXES][BINS];
        for (int axis = 0; axis < AXES; ++axis)
            for (int k = 0; k < BINS; ++k) {
                bins[axis][k].clear();
                counts[axis][k] = 0;
            }
        for (int k = first; k < first + count; ++k) {
            const int triangle = sorting.order.data[k];
            const float* at = box(triangle);
            for (int axis = 0; axis < AXES; ++axis) {
                const int number = bin(middles, triangle, axis);
                bins[axis][number].grow(at, at + 4);
                ++counts[axis][number];
            }
        }
        float least = 3.0e38f;
        int best_axis = -1, best = 0;
        for (int axis = 0; axis < AXES; ++axis) {
            // Cost of the right sides first, then of the left ones on the way.
            float right[BINS];
            Box side;
            side.clear();
            int within = 0;
            for (int k = BINS - 1; k > 0; --k) {
                side.grow(bins[axis][k].low, bins[axis][k].high);
                within += counts[axis][k];
                right[k] = within ? side.area() * blocks(within) : 0.0f;
            }
            side.clear();
            within = 0;
            for (int k = 1; k < BINS; ++k) {
                side.grow(bins[axis][k - 1].low, bins[axis][k - 1].high);
                within += counts[axis][k - 1];
                const float cost = within ? side.area() * blocks(within) + right[k] : 3.0e38f;
                if (cost < least && enough(within, count)) {
                    least = cost;
                    best_axis = axis;
                    best = k;
                }
            }
        }
        if (best_axis < 0)
            return 0;
        return part(first, first + count, { Front::BINS_BEFORE, best_axis, best, middles, 0 });
    }
    // In the order of the numbers that they are the bits of.
    inline unsigned key(int triangle, int axis) const {
        const float number = middle(triangle, axis);
        unsigned bits;
        memcpy(&bits, &number, sizeof(bits));
        return bits >> 31 ? ~bits : bits | 0x80000000u;
    }
    // The half with the lesser middles along the longest axis, found digit by digit.
    inline int by_median(int first, int count) const {
        const Box around = around_middles(first, count);
        int axis = 0;
        for (int k = 1; k < AXES; ++k)
            if (around.high[k] - around.low[k] > around.high[axis] - around.low[axis])
                axis = k;
        const int wanted = half(count);
        unsigned found = 0, known = 0;
        int below = 0; // keys less than any that begin with what has been found
        for (int shift = KEY_BITS - DIGIT; shift >= 0; shift -= DIGIT) {
            int counts[DIGITS];
            for (int k = 0; k < DIGITS; ++k)
                counts[k] = 0;
            for (int k = first; k < first + count; ++k) {
                const unsigned bits = key(sorting.order.data[k], axis);
                if ((bits & known) == found)
                    ++counts[bits >> shift & (DIGITS - 1)];
            }
            int digit = 0;
            while (digit < DIGITS - 1 && below + counts[digit] <= wanted)
                below += counts[digit++];
            found |= (unsigned)digit << shift;
            known |= (unsigned)(DIGITS - 1) << shift;
        }
        const int less = part(first, first + count, { Front::LESS, axis, 0, {}, found });
        part(first + less, first + count, { Front::EQUAL, axis, 0, {}, found });
        return wanted;
    }
    // Where the highest bit changes that is not the same in all; they are in the order of their codes.
    inline int by_code(int first, int count) const {
        const int* codes = sorting.codes.data;
        const int differ = codes[first] ^ codes[first + count - 1];
        if (!differ)
            return 0;
        int bit = 1 << 30;
        while (!(differ & bit))
            bit >>= 1;
        int low = first, high = first + count - 1; // without the bit, and with it
        while (high - low > 1) {
            const int at = (low + high) / 2;
            (codes[at] & bit ? high : low) = at;
        }
        const int left = high - first;
        return left < FEWEST ? FEWEST : count - left < FEWEST ? count - FEWEST : left;
    }
    inline void leaf(int node, int first, int count) const {
        const int block = wp::atomic_add(tree.counts.data + COUNT_OF_BLOCKS, 1);
        int* members = tree.members.data + TREE_LANES * (size_t)block;
        for (int k = 0; k < TREE_LANES; ++k)
            members[k] = k < count ? sorting.order.data[first + k] : -1;
        tree.leaves.data[block] = node;
        tree.children.data[2 * (size_t)node] = ~block;
        tree.children.data[2 * (size_t)node + 1] = 0;
    }
    // Until then the children of a node are the first of its triangles, and their number. Returns the first child.
    inline int split(int node, int level, int rule) const {
        int* children = tree.children.data + 2 * (size_t)node;
        const int first = children[0], count = children[1];
        if (count <= TREE_LANES) {
            leaf(node, first, count);
            return 0;
        }
        int left = 0;
        if (level < RULED)
            left = rule == RULE_SAH      ? by_area(first, count)
                   : rule == RULE_MEDIAN ? by_median(first, count)
                                         : by_code(first, count);
        if (!enough(left, count))
            left = half(count);
        const int made = wp::atomic_add(tree.counts.data + COUNT_OF_NODES, 2);
        int* below = tree.children.data + 2 * (size_t)made;
        below[0] = first;
        below[1] = left;
        below[2] = first + left;
        below[3] = count - left;
        children[0] = made;
        children[1] = made + 1;
        return made;
    }
    static inline void split_one(const Tree& tree, const Sorting& sorting, int node, int level, int rule) {
        Build{ tree, sorting }.split(node, level, rule);
    }
    // All from the root on in one thread, depth first.
    static inline void whole(const Tree& tree, const Sorting& sorting, int rule) {
        const Build it = { tree, sorting };
        int nodes[LEVELS + 1], levels[LEVELS + 1];
        int top = 1;
        nodes[0] = levels[0] = 0;
        while (top) {
            const int node = nodes[--top], level = levels[top];
            const int made = it.split(node, level, rule);
            if (!made)
                continue;
            for (int k = 1; k >= 0; --k) {
                nodes[top] = made + k;
                levels[top++] = level + 1;
            }
        }
    }
};
