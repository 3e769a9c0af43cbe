// cpu
// needs: visibility/mask.h accelerators/segment.h accelerators/bvh/bundle.h@16 exact/mask_filter.h exact/mask_range.h
// needs: accelerators/bvh/shaft.h
// constants: TREE_LANES TREE_NONE BLOCK_ROWS LEVELS MASK_CLOSE
// arguments: Tree structure
// A sample, and all points of a light, through the tree with sixteen children per node.
struct Walk1 {
    // Of each level at most all children but one wait.
    // Children of a node that a bundle must meet for their ranges to be asked for.
    enum { DEPTH = TREE_LANES * (LEVELS + 1), MANY = 3 };
    // As many triangles of a block must be left for their ranges to be worth it. Up to so many points are judged one
    // by one, each with all triangles of a block.
    enum { SEVERAL = 2, FEW = 16 };
    MaskFilter filter;
    MaskRange range;
    const Tree& tree;
    float longest;
    const BundleSides sides;
    bool looks, ranges; // whether the filter can be used, and ranges of points

    inline Walk1(const Tree& tree, const Segment& segment, const Query1& query)
        : tree(tree), longest(segment.longest), sides(query, segment, tree.box) {
        const wp::vec4d& sample = query.sample();
        double from_center[3];
        for (int k = 0; k < 3; ++k)
            from_center[k] = (sample[k] - tree.box.center[k]) * tree.box.inverse_extent;
        looks = filter.look(from_center, query.middle, query.spread(), query.shortest, query.longest, sample[3],
                            tree.box.inverse_extent, query.light()[3] == 0.0);
        const Asked& asked = query.asked;
        ranges =
            looks && asked.ranges
            && (asked.radius > 0.0 ? range.look_at_tube(query.middle, asked.u, asked.radius, filter.reach, filter.unit)
                                   : range.look(query.middle, asked.u, asked.v, filter.reach, filter.unit));
    }
    // Shows a triangle; true if no point is seen any more.
    inline bool triangle(int number, int lane, wp::uint64 wanted, Query1& query) const {
        wanted &= query.open & (ranges ? range.points(lane, query.asked.beyond.data) : query.open);
        if (!wanted)
            return false;
        if (!(filter.told >> lane & 1))
            return query.visit(number);
        ++query.tests;
        const bool all = filter.all >> lane & 1;
        if (all && query.asked.cull == 0) {
            query.hidden_by(number);
            return true;
        }
        wp::uint64 sure = ~(wp::uint64)0, maybe = sure;
        if (!all)
            filter.points(lane, query.asked.offsets.data, wanted, sure, maybe);
        query.judged(number, sure, maybe & wanted);
        return query.open == 0;
    }
    // Shows the triangles of a block that are told, point by point.
    inline void each_point(const int* members, wp::uint64 wanted, Query1& query) const {
        const float* offsets = query.asked.offsets.data;
        const int certain = query.asked.cull == 0 ? (int)Lanes16::ALL : 0;
        wp::uint64 hidden = 0, doubtful = 0;
        int touching = 0, everyone = certain & filter.told, sure, maybe;
        for (wp::uint64 left = wanted; left; left &= left - 1) {
            filter.of_point(offsets + __builtin_ctzll(left), sure, maybe);
            touching |= maybe;
            everyone &= sure;
            hidden |= sure & certain ? left & -left : 0;
            doubtful |= maybe ? left & -left : 0;
        }
        query.tests += __builtin_popcount(touching);
        query.open &= ~hidden;
        if (everyone && query.open == 0)
            query.hidden_by(members[__builtin_ctz(everyone)]);
        for (wp::uint64 left = doubtful & ~hidden; left; left &= left - 1) {
            filter.of_point(offsets + __builtin_ctzll(left), sure, maybe);
            query.judged_at(__builtin_ctzll(left), members, maybe);
        }
    }
    // Shows a block of which few points are wanted; true if no point is seen any more.
    inline bool few_points(const int* members, wp::uint64 wanted, Query1& query) {
        const Mask16 each = *(const Mask16*)members;
        filter.may &= Lanes16::bits((each >= 0) & (each < query.triangle_count()));
        filter.told &= filter.may;
        if (filter.told)
            each_point(members, wanted, query);
        for (int left = query.open ? filter.may & ~filter.told : 0; left; left &= left - 1)
            if (query.visit(members[__builtin_ctz(left)]))
                return true;
        return query.open == 0;
    }
    // Shows a block, which no other points than those that are wanted are asked about; true if none is seen any more.
    inline bool block(int number, wp::uint64 wanted, Query1& query) {
        const int casting = tree.left_out ? tree.casting_blocks.data[number] : (int)Lanes16::ALL;
        if (!casting)
            return false;
        const int* members = tree.members.data + TREE_LANES * (size_t)number;
        __builtin_prefetch(members);
        const float* rows = tree.rows.data + BLOCK_ROWS * TREE_LANES * (size_t)number;
        const bool few = __builtin_popcountll(wanted) <= FEW;
        if (looks)
            filter.judge(rows, few);
        else
            filter.may = Lanes16::ALL, filter.all = filter.told = 0;
        filter.may &= casting;
        if (!filter.may)
            return false;
        if (few)
            return few_points(members, wanted, query);
        range.known = range.missed = 0;
        if (ranges && __builtin_popcount(filter.may & ~filter.all) >= SEVERAL)
            range.judge(rows, filter.at, filter.place);
        for (int left = filter.may & ~range.missed; left; left &= left - 1) {
            const int lane = __builtin_ctz(left);
            if (members[lane] >= 0 && members[lane] < query.triangle_count()
                && triangle(members[lane], lane, wanted, query))
                return true;
        }
        return false;
    }
    // Shows a block, and keeps it for the next sample if it hides points from this one; true if none is seen any more.
    inline bool ask(int number, wp::uint64 wanted, Query1& query) {
        const wp::uint64 before = query.open;
        ++query.nodes;
        const bool done = block(number, wanted, query);
        if (query.open != before && query.keeps < Query1::KEPT)
            query.kept[query.keeps++] = number;
        return done;
    }
    inline void descend(Query1& query) {
        // What hid points from the sample before mostly hides some from this one.
        int asked[Query1::KEPT];
        const int first = query.keeps;
        query.keeps = 0;
        for (int k = 0; k < first; ++k)
            asked[k] = query.kept[k];
        for (int k = 0; k < first; ++k)
            if (ask(asked[k], query.open, query))
                return;
        int links[DEPTH];
        wp::uint64 points[DEPTH]; // of the light that something below a link may hide
        int top = 1;
        links[0] = 0;
        points[0] = query.open;
        while (top) {
            const int link = links[--top];
            if (!(points[top] & query.open))
                continue;
            if (link < 0) {
                bool again = false;
                for (int k = 0; k < first; ++k)
                    again |= asked[k] == ~link;
                if (!again && ask(~link, points[top] & query.open, query))
                    return;
                continue;
            }
            ++query.nodes;
            const Real16* bounds = (const Real16*)(tree.bounds.data + 6 * TREE_LANES * (size_t)link);
            const int* children = tree.links.data + TREE_LANES * (size_t)link;
            __builtin_prefetch(children);
            Bundle16 bundle;
            bundle.enter(bounds, bounds + 3, sides, longest);
            int met = tree.left_out ? bundle.met & tree.casting_nodes.data[link] : bundle.met;
            const bool boxed = ranges && __builtin_popcount(met) >= MANY && query.spares.worth(query.nodes);
            if (boxed)
                range.boxes(bounds, filter.at, filter.place);
            const int begin = top, may = boxed ? met & ~range.missed : met;
            // What is close to the sample is asked first: its own surface, if that is turned away from the light.
            const int close = may & Lanes16::bits(bundle.in < (float)MASK_CLOSE * longest);
            for (int after = 0; after < 2; ++after)
                for (int left = after ? close : may & ~close; left; left &= left - 1) {
                    const int lane = __builtin_ctz(left), child = children[lane];
                    if (child == TREE_NONE)
                        continue;
                    points[top] = boxed ? range.points(lane, query.asked.beyond.data) : ~(wp::uint64)0;
                    links[top] = child;
                    top += (points[top] & query.open) != 0;
                }
            if (boxed)
                query.spares.learn(__builtin_popcount(met) - (top - begin));
        }
    }
    // Finds out whether nothing hides any point from the sample and from those after it. Pixels of images mostly lie on
    // what is in the scene, which is not seen to be beside them by so many at once.
    static inline bool free(const Tree& tree, Query1& query) {
        Query1::Neighbours& some = query.neighbours;
        if (query.ray[0] < some.end)
            return some.free;
        if (query.keeps || query.asked.every != 1 || query.asked.width > 0)
            return false;
        some.free = false;
        wp::vec3d low, high;
        const int count = query.around(low, high);
        if (count < Query1::Neighbours::FEWEST || !some.tries.worth(some.end / Query1::Neighbours::TOGETHER))
            return false;
        Shaft shaft{ tree };
        some.free = shaft.look(query, low, high) && shaft.empty(query);
        some.tries.learn(some.free ? count : 0);
        return some.free;
    }
    static inline void walk(const Tree& tree, Query1& query) {
        if (query.hidden_by_next() || free(tree, query))
            return;
        Segment segment;
        const int place = segment.place(query, tree.box);
        if (place == Segment::TOO_FAR)
            query.everything();
        if (place == Segment::MEETS)
            Walk1(tree, segment, query).descend(query);
    }
};
