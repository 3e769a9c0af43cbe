// cpu
// needs: accelerators/light_grid/together16.h
// constants: FACES NODES_VISITED ENTRIES
// arguments: LightSpace space, Tiles tiles, Occluders occluders, EntryList entries, Answers answers
// Triangles into tiles, sixteen triangles and sixteen boxes at a time: the binning of one thread for all triangles.
struct Binning16 : Together16 {
    // A triangle that touches fewer columns is small: its bounds say nearly all.
    enum { FEW_COLUMNS = 4 };

    inline Binning16(const Tiles& tiles, const Occluders& occluders, const EntryList& entries, const Answers& answers)
        : Together16(tiles, occluders, entries, answers) {}
    inline int meets(const wp::array_t<float>& boxes, int number, int& covered) {
        nodes += 16;
        return side.meets(TileBox::at(boxes, number), covered);
    }
    inline void accept_all(int first, int count) {
        for (int tile = first; tile < first + count; ++tile)
            accept(tile);
    }
    inline void visit_block(int block, int record) {
        int covered;
        const int hit = meets(tiles.boxes, 16 * block, covered);
        for (int left = covered; left; left &= left - 1)
            accept(16 * block + __builtin_ctz(left));
        enter_tiles(16 * block, hit & ~covered, record);
    }
    inline void visit(const TileGroup& group, int record) {
        int from, to;
        group.columns(side.low_u, side.high_u, from, to);
        if (side.bounded && to - from < FEW_COLUMNS) {
            for (int column = from; column <= to; ++column)
                for (int inner = touches(tiles.blocks, 16 * (group.first_column + column)); inner; inner &= inner - 1)
                    visit_block(group.first_block + column * group.length + __builtin_ctz(inner), record);
            return;
        }
        for (int sixteen = from / 16; sixteen <= to / 16 && from <= to; ++sixteen) {
            int whole;
            int some = meets(tiles.columns, group.first_column + 16 * sixteen, whole);
            for (; some; some &= some - 1) {
                const int lane = __builtin_ctz(some), column = 16 * sixteen + lane;
                const int first_block = group.first_block + column * group.length;
                if (whole >> lane & 1) {
                    accept_all(16 * first_block, 16 * group.blocks_of(column));
                    continue;
                }
                int covered;
                int inner = meets(tiles.blocks, 16 * (group.first_column + column), covered);
                for (; inner; inner &= inner - 1) {
                    const int b = __builtin_ctz(inner);
                    if (covered >> b & 1)
                        accept_all(16 * (first_block + b), 16);
                    else
                        visit_block(first_block + b, record);
                }
            }
        }
    }
    // The triangles of some clusters, and the light at `place`; entries that are left stay in the list.
    static inline void light(int place, int first_record, int first_corner, int first_cluster, int last_cluster,
                             const wp::array_t<int>& clusters, const wp::array_t<float>& corners,
                             const LightSpace& space, const Tiles& tiles, const Occluders& occluders,
                             const EntryList& entries, const Answers& answers) {
        Binning16 it(tiles, occluders, entries, answers);
        const bool aligned = tiles.aligned.data[place] != 0;
        Front16 front;
        Planes16 planes;
        Seen16 seen;
        for (int k = first_cluster; k < last_cluster; ++k) {
            const int first = 16 * clusters.data[k], left = occluders.count - first, count = left < 16 ? left : 16;
            front.corners.load(corners.data + 12 * (size_t)(first_corner + first));
            front.open(0xFFFF >> (16 - count), aligned);
            bool taken = false;
            for (int face = 0; face < FACES; ++face) {
                const int number = FACES * place + face;
                if (!TileGroup::any(tiles, number))
                    continue;
                int some = front.bound(face, tiles.fit.data[number], space.inverse != 0, seen);
                if (!some)
                    continue;
                const TileGroup group(tiles, number);
                const int close = it.gather(group, seen, some);
                const int visited = close ? it.touched(seen, close, it.list_tiles(group)) : 0;
                some &= ~close;
                if (!visited && !some)
                    continue;
                if (!taken)
                    planes.take(it.record(first_record + first), count, space);
                taken = true;
                it.enter_all(planes, face, visited, first_record + first);
                for (some &= ~planes.silent; some; some &= some - 1) {
                    const int j = __builtin_ctz(some);
                    it.side.take(planes, seen, face, j);
                    it.visit(group, first_record + first + j);
                }
            }
        }
        answers.counters.data[NODES_VISITED] += it.nodes;
        answers.counters.data[ENTRIES] += it.entered;
        it.report();
    }
};
