// needs: accelerators/light_grid/tiles.h accelerators/light_grid/side.h@1 device/warp.h
// constants: FACES NODES_VISITED ITEM_COLUMNS LONG_WALK SHORT IN_ITEMS LONG
// arguments: LightSpace space, Tiles tiles, Occluders occluders, Bins bins, Answers answers
// The tiles that a triangle may touch. One thread takes it a box at a time, as long as there are few; else it becomes
// items of some columns each, and a warp takes an item 32 boxes at a time.
struct Binning {
    const LightSpace& space;
    const Tiles& tiles;
    const Occluders& occluders;
    const Bins& bins;
    const Answers& answers;
    int triangle, place, emit;
    wp::int64 number; // of the next entry, counted from the window that is emitted
    wp::int64 nodes;
    Side1 side;

    inline Binning(int triangle, int place, int emit, wp::int64 number, const LightSpace& space, const Tiles& tiles,
                   const Occluders& occluders, const Bins& bins, const Answers& answers)
        : space(space), tiles(tiles), occluders(occluders), bins(bins), answers(answers), triangle(triangle),
          place(place), emit(emit), number(number), nodes(0) {}
    // Not a member: it is indexed by the axes of faces, and compilers for CUDA put all of an object that has such an
    // array into local memory, with what it refers to.
    inline void open(Front1& front) const {
        front.corners.gather(occluders.corners.data + (size_t)place * occluders.corners_apart,
                             occluders.triangles.data[triangle]);
        front.open(1, tiles.aligned.data[place] != 0);
    }
    inline int record() const { return place * occluders.records_apart + triangle; }
    // Takes the triangle's side on a face; false if it cannot touch the rays there, or casts nothing.
    inline bool look(const Front1& front, int face) {
        const int group = FACES * place + face;
        Seen1 seen;
        if (!TileGroup::any(tiles, group) || !front.bound(face, tiles.fit.data[group], space.inverse != 0, seen))
            return false;
        Planes1 planes;
        planes.take((const float*)occluders.records.data + 16 * (size_t)record(), 1, space);
        if (planes.silent)
            return false;
        side.take(planes, seen, face, 0);
        return true;
    }
    inline void cover(int first, int count) {
        for (int tile = first; tile < first + count; ++tile)
            tiles.covered.data[tile] = 1;
    }
    inline void enter(int tile) {
        const wp::int64 at = number++;
        if (emit)
            store(at, tile);
    }
    inline void store(wp::int64 at, int tile) const {
        if (at < 0 || at >= bins.capacity)
            return;
        bins.tile.data[at] = tile;
        bins.record.data[at] = record();
        bins.rank.data[at] = wp::atomic_add(&bins.length.data[tile], 1);
    }
    inline bool meets(const wp::array_t<float>& boxes, int box, int& covered) {
        ++nodes;
        return side.meets(TileBox::at(boxes, box), covered) != 0;
    }
    // Counts or stores the entries of some columns; false if it has come to too many boxes, and ends there.
    inline bool visit(const TileGroup& group, int from, int to) {
        int covered;
        for (int column = from; column <= to; ++column) {
            if (emit == 0 && nodes > LONG_WALK)
                return false;
            if (!meets(tiles.columns, group.first_column + column, covered))
                continue;
            const int first_block = group.first_block + column * group.length, blocks = group.blocks_of(column);
            if (covered) {
                cover(16 * first_block, 16 * blocks);
                continue;
            }
            for (int b = 0; b < blocks; ++b) {
                if (emit == 0 && nodes > LONG_WALK)
                    return false;
                const int block = first_block + b;
                if (!meets(tiles.blocks, 16 * (group.first_column + column) + b, covered))
                    continue;
                if (covered) {
                    cover(16 * block, 16);
                    continue;
                }
                for (int tile = 16 * block; tile < 16 * block + 16; ++tile) {
                    if (!meets(tiles.boxes, tile, covered))
                        continue;
                    if (covered)
                        cover(tile, 1);
                    else
                        enter(tile);
                }
            }
        }
        return true;
    }
    // The same by a warp.
    inline void visit_together(const TileGroup& group, int from, int to) {
        for (int base = from; base <= to; base += 32) {
            Met met;
            for (int lane = Warp::first(); lane < Warp::last(); ++lane)
                if (base + lane <= to)
                    meet(tiles.columns, group.first_column + base + lane, lane, met);
            met.join();
            nodes += to - base < 31 ? to - base + 1 : 32;
            for (unsigned rest = met.whole; rest; rest &= rest - 1) {
                const int column = base + Warp::lowest(rest), tile = 16 * (group.first_block + column * group.length);
                for (int lane = Warp::first(); lane < Warp::last(); ++lane)
                    for (int k = lane; k < 16 * group.blocks_of(column); k += 32)
                        cover(tile + k, 1);
            }
            for (unsigned rest = met.parted(); rest;) {
                const int first = base + Warp::lowest(rest);
                rest &= rest - 1;
                const int second = rest ? base + Warp::lowest(rest) : -1;
                rest &= rest - 1;
                visit_blocks(group, first, second);
            }
        }
    }
    // The blocks of two columns, or of one.
    inline void visit_blocks(const TileGroup& group, int first, int second) {
        Met met;
        for (int lane = Warp::first(); lane < Warp::last(); ++lane) {
            const int column = lane < 16 ? first : second;
            if (column >= 0 && (lane & 15) < group.blocks_of(column))
                meet(tiles.blocks, 16 * (group.first_column + column) + (lane & 15), lane, met);
        }
        met.join();
        nodes += group.blocks_of(first) + (second >= 0 ? group.blocks_of(second) : 0);
        for (unsigned rest = met.whole; rest; rest &= rest - 1) {
            const int tile = 16 * block_of(group, first, second, Warp::lowest(rest));
            for (int lane = Warp::first(); lane < Warp::last(); ++lane)
                if (lane < 16)
                    cover(tile + lane, 1);
        }
        for (unsigned rest = met.parted(); rest;) {
            const int block = block_of(group, first, second, Warp::lowest(rest));
            rest &= rest - 1;
            const int next = rest ? block_of(group, first, second, Warp::lowest(rest)) : -1;
            rest &= rest - 1;
            visit_tiles(block, next);
        }
    }
    static inline int block_of(const TileGroup& group, int first, int second, int lane) {
        return group.first_block + (lane < 16 ? first : second) * group.length + (lane & 15);
    }
    // The tiles of two blocks, or of one.
    inline void visit_tiles(int first, int second) {
        Met met;
        for (int lane = Warp::first(); lane < Warp::last(); ++lane)
            if (lane < 16 || second >= 0)
                meet(tiles.boxes, 16 * (lane < 16 ? first : second) + (lane & 15), lane, met);
        met.join();
        nodes += second >= 0 ? 32 : 16;
        const unsigned entered = met.parted();
        for (int lane = Warp::first(); lane < Warp::last(); ++lane) {
            const int tile = 16 * (lane < 16 ? first : second) + (lane & 15);
            if (met.whole >> lane & 1)
                cover(tile, 1);
            else if (emit && entered >> lane & 1)
                store(number + Warp::count(entered & ((1u << lane) - 1)), tile);
        }
        number += Warp::count(entered);
    }
    // The lanes whose boxes the triangle cannot be said to miss, and those whose boxes it covers.
    struct Met {
        unsigned some, whole;
        inline Met() : some(0), whole(0) {}
        inline void join() {
            some = Warp::joined(some);
            whole = Warp::joined(whole);
        }
        inline unsigned parted() const { return some & ~whole; }
    };
    inline void meet(const wp::array_t<float>& boxes, int box, int lane, Met& met) const {
        int covered;
        if (!side.meets(TileBox::at(boxes, box), covered))
            return;
        met.some |= 1u << lane;
        met.whole |= covered ? 1u << lane : 0u;
    }
    inline void report() {
        if (emit == 0 && nodes > 0)
            Warp::add(answers.counters.data + answers.counters.shape[1] * (triangle & 63) + NODES_VISITED, (int)nodes);
    }

    // Makes items of all that a triangle may touch, if there is room for them.
    static inline void itemise(int unit, int triangle, int place, const LightSpace& space, const Tiles& tiles,
                               const Occluders& occluders, const Bins& bins, const Answers& answers) {
        if (bins.length_of.data[unit] != LONG)
            return;
        Binning it(triangle, place, 0, 0, space, tiles, occluders, bins, answers);
        Front1 front;
        it.open(front);
        const int room = bins.items.shape[0];
        int count = 0, slot = 0, to = 0;
        // First they are counted; then they have places.
        for (int k = 0; k < 2 * FACES; ++k) {
            if (k == FACES) {
                // The counter stays below room + count.
                if (bins.item_count.data[0] > room - count)
                    return;
                slot = to = wp::atomic_add(&bins.item_count.data[0], count);
                if (slot + count > room) {
                    // Too late: what is left of the room holds nothing.
                    for (int rest = slot; rest < room; ++rest)
                        bins.items.data[rest] = wp::vec4i(0, 0, 0, -1);
                    return;
                }
                bins.length_of.data[unit] = IN_ITEMS;
            }
            const int face = k < FACES ? k : k - FACES;
            if (!it.look(front, face))
                continue;
            if (k < FACES)
                count += it.items_of(face, 0, 0);
            else
                to += it.items_of(face, to, slot + count);
        }
    }
    // The number of items of a face that was looked at; they go from place `to` on, as long as that is below `end`.
    inline int items_of(int face, int to, int end) const {
        int from, last;
        TileGroup(tiles, FACES * place + face).columns(side.low_u, side.high_u, from, last);
        const int n = from > last ? 0 : (last - from + ITEM_COLUMNS) / ITEM_COLUMNS;
        for (int k = 0; k < n && to + k < end; ++k) {
            const int first = from + ITEM_COLUMNS * k, most = first + ITEM_COLUMNS - 1;
            bins.items.data[to + k] = wp::vec4i(record(), face, first, most < last ? most : last);
        }
        return n;
    }
    // Counts, or with `emit` stores, the entries of a triangle, number `unit` of all; returns how many. None of one
    // that is too long.
    static inline wp::int64 whole(int unit, int triangle, int place, int emit, wp::int64 before, wp::int64 window,
                                  const LightSpace& space, const Tiles& tiles, const Occluders& occluders,
                                  const Bins& bins, const Answers& answers) {
        if (emit && bins.length_of.data[unit] != SHORT)
            return 0;
        Binning it(triangle, place, emit, before - window, space, tiles, occluders, bins, answers);
        Front1 front;
        it.open(front);
        bool ended = true;
        for (int face = 0; face < FACES && ended; ++face) {
            if (!it.look(front, face))
                continue;
            const TileGroup group(tiles, FACES * place + face);
            int from, to;
            group.columns(it.side.low_u, it.side.high_u, from, to);
            ended = it.visit(group, from, to);
        }
        it.report();
        if (emit == 0)
            bins.length_of.data[unit] = ended ? SHORT : LONG;
        return ended ? it.number - (before - window) : 0;
    }
    // The same by a warp, of some faces and columns of a triangle.
    static inline wp::int64 together(int triangle, int place, int first_face, int last_face, int first_column,
                                     int last_column, int emit, wp::int64 before, wp::int64 window,
                                     const LightSpace& space, const Tiles& tiles, const Occluders& occluders,
                                     const Bins& bins, const Answers& answers) {
        Binning it(triangle, place, emit, before - window, space, tiles, occluders, bins, answers);
        Front1 front;
        it.open(front);
        for (int face = first_face; face <= last_face; ++face) {
            if (!it.look(front, face))
                continue;
            const TileGroup group(tiles, FACES * place + face);
            int from, to;
            group.columns(it.side.low_u, it.side.high_u, from, to);
            it.visit_together(group, from > first_column ? from : first_column, to < last_column ? to : last_column);
        }
        if (Warp::first() == 0)
            it.report();
        return it.number - (before - window);
    }
};
