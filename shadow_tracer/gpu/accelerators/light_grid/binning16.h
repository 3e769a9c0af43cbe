// cpu
// needs: accelerators/light_grid/together16.h accelerators/light_grid/cluster.h
// constants: FACES NODES_VISITED ENTRIES
// arguments: LightFrame frame, LightSpace space, Tiles tiles, Casters casters, EntryList entries, Answers answers
// Triangles into tiles, sixteen triangles and sixteen boxes at a time: the binning of one thread for all triangles.
struct Binning16 : Together16 {
    // A triangle that touches fewer columns is small: its bounds say nearly all.
    enum { FEW_COLUMNS = 4 };

    inline Binning16(const Tiles& tiles, const EntryList& entries, const Answers& answers)
        : Together16(tiles, entries, answers) {}
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
    static inline void light(int place, int first_cluster, int last_cluster, const wp::array_t<int>& clusters,
                             const wp::array_t<wp::uint8>& faces, const LightFrame& frame, const LightSpace& space,
                             const Tiles& tiles, const Casters& casters, const EntryList& entries,
                             const Answers& answers) {
        Binning16 it(tiles, entries, answers);
        const bool aligned = tiles.aligned.data[place] != 0;
        Cluster cluster(casters, frame, space);
        Seen16 seen;
        for (int k = first_cluster; k < last_cluster; ++k) {
            if (k + 1 < last_cluster)
                cluster.fetch(clusters.data[k + 1]);
            cluster.open(clusters.data[k], aligned);
            int record = -1; // of the first of them, if their planes are known
            for (int left = faces.data[k]; left; left &= left - 1) {
                const int face = __builtin_ctz(left), number = FACES * place + face;
                int some = cluster.front.bound(face, tiles.fit.data[number], space.inverse != 0, seen);
                if (!some)
                    continue;
                const TileGroup group(tiles, number);
                const int close = it.gather(group, seen, some);
                const int visited = close ? it.touched(seen, close, it.list_tiles(group)) : 0;
                some &= ~close;
                if (!visited && !some)
                    continue;
                if (record < 0) {
                    record = it.open_records(cluster.first);
                    cluster.take(place, it.record(record));
                }
                it.enter_all(cluster.planes, face, visited, record);
                for (some &= ~cluster.planes.silent; some; some &= some - 1) {
                    const int j = __builtin_ctz(some);
                    it.side.take(cluster.planes, seen, face, j);
                    it.visit(group, record + j);
                }
            }
            if (record >= 0)
                it.close_records();
        }
        answers.counters.data[NODES_VISITED] += it.nodes;
        answers.counters.data[ENTRIES] += it.entered;
        it.report();
    }
};
