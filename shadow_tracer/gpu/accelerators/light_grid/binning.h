// needs: accelerators/light_grid/tiles.h accelerators/light_grid/side.h@1
// constants: FACES NODES_VISITED ITEM_COLUMNS MANY_COLUMNS
// arguments: LightSpace space, Tiles tiles, Occluders occluders, Bins bins, Answers answers
// One triangle and one thread: the tiles it may touch, a box at a time.
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
        if (emit == 0 || at < 0 || at >= bins.capacity)
            return;
        bins.tile.data[at] = tile;
        bins.record.data[at] = record();
        bins.rank.data[at] = wp::atomic_add(&bins.length.data[tile], 1);
    }
    inline bool meets(const wp::array_t<float>& boxes, int box, int& covered) {
        ++nodes;
        return side.meets(TileBox::at(boxes, box), covered) != 0;
    }
    inline void visit(const TileGroup& group, int from, int to) {
        int covered;
        for (int column = from; column <= to; ++column) {
            if (!meets(tiles.columns, group.first_column + column, covered))
                continue;
            const int first_block = group.first_block + column * group.length, blocks = group.blocks_of(column);
            if (covered) {
                cover(16 * first_block, 16 * blocks);
                continue;
            }
            for (int b = 0; b < blocks; ++b) {
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
    }
    inline void report() {
        if (emit == 0 && nodes > 0)
            wp::atomic_add(answers.counters.data + answers.counters.shape[1] * (triangle & 63) + NODES_VISITED, nodes);
    }

    // Makes items of the faces on which the triangle may touch many columns.
    static inline void itemise(int triangle, int place, const LightSpace& space, const Tiles& tiles,
                               const Occluders& occluders, const Bins& bins, const Answers& answers) {
        Binning it(triangle, place, 0, 0, space, tiles, occluders, bins, answers);
        Front1 front;
        it.open(front);
        int faces_out = 0;
        for (int face = 0; face < FACES; ++face) {
            if (!it.look(front, face))
                continue;
            int from, to;
            TileGroup(tiles, FACES * place + face).columns(it.side.low_u, it.side.high_u, from, to);
            if (to - from + 1 <= MANY_COLUMNS)
                continue;
            const int n = (to - from + ITEM_COLUMNS) / ITEM_COLUMNS, room = bins.items.shape[0];
            // As long as it does not fit, a thread takes all of the triangle. The counter stays below room + n.
            if (bins.item_count.data[0] > room - n)
                continue;
            const int slot = wp::atomic_add(&bins.item_count.data[0], n);
            if (slot + n > room) {
                // Too late: what is left of the room holds nothing.
                for (int k = slot; k < room; ++k)
                    bins.items.data[k] = wp::vec4i(0, 0, 0, -1);
                continue;
            }
            for (int k = 0; k < n; ++k) {
                const int first = from + ITEM_COLUMNS * k, last = first + ITEM_COLUMNS - 1;
                bins.items.data[slot + k] = wp::vec4i(it.record(), face, first, last < to ? last : to);
            }
            faces_out |= 1 << face;
        }
        bins.itemised.data[it.record()] = faces_out;
    }
    // Counts, or with `emit` stores, what did not become items; returns the number of entries.
    static inline wp::int64 whole(int triangle, int place, int emit, wp::int64 before, wp::int64 window,
                                  const LightSpace& space, const Tiles& tiles, const Occluders& occluders,
                                  const Bins& bins, const Answers& answers) {
        Binning it(triangle, place, emit, before - window, space, tiles, occluders, bins, answers);
        Front1 front;
        it.open(front);
        const int out = bins.itemised.data[it.record()];
        for (int face = 0; face < FACES; ++face) {
            if (out >> face & 1 || !it.look(front, face))
                continue;
            const TileGroup group(tiles, FACES * place + face);
            int from, to;
            group.columns(it.side.low_u, it.side.high_u, from, to);
            it.visit(group, from, to);
        }
        it.report();
        return it.number - (before - window);
    }
    static inline wp::int64 item(int triangle, int place, int face, int first_column, int last_column, int emit,
                                 wp::int64 before, wp::int64 window, const LightSpace& space, const Tiles& tiles,
                                 const Occluders& occluders, const Bins& bins, const Answers& answers) {
        Binning it(triangle, place, emit, before - window, space, tiles, occluders, bins, answers);
        Front1 front;
        it.open(front);
        if (it.look(front, face))
            it.visit(TileGroup(tiles, FACES * place + face), first_column, last_column);
        it.report();
        return it.number - (before - window);
    }
};
