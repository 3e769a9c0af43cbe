// cpu
// needs: exact/filter.h@16 accelerators/light_grid/hidden.h accelerators/light_grid/magnitudes16.h device/compress.h
// constants: LEAF_TESTS ACCEPTED ALL_BLOCKS
// arguments: Tiles tiles, EntryList entries, Answers answers
// Entries gather in a list; whenever it is full, it is sorted by tile and traced, tile by tile, sixteen rays at a time.
struct Entries {
    // With fewer entries per tile than one in so many, sorting costs more than it gains.
    enum { TILES_PER_ENTRY = 8, AHEAD = 4 };
    const Tiles& tiles;
    const EntryList& entries;
    const Answers& answers;
    wp::int64 tests, accepted, entered;
    int flushes, flushed, waiting; // so far, and when records were opened: also how many entries waited

    inline Entries(const Tiles& tiles, const EntryList& entries, const Answers& answers)
        : tiles(tiles), entries(entries), answers(answers), tests(0), accepted(0), entered(0), flushes(0), flushed(0),
          waiting(0) {}
    inline float* record(int number) const { return entries.records.data + 16 * (size_t)number; }
    inline int triangle(int number) const { return entries.first.data[number >> 4] + (number & 15); }
    // The number of the first of sixteen records to be made, of the triangles from `first` on. There is room for so
    // many clusters of which entries wait; when it is full they are traced.
    inline int open_records(int first) {
        int& used = entries.count.data[2];
        if (used == entries.clusters)
            flush();
        if (entries.count.data[0] == 0)
            used = 0;
        entries.first.data[used] = first;
        waiting = entries.count.data[0];
        flushed = flushes;
        return 16 * used;
    }
    // They stay if an entry of theirs may wait.
    inline void close_records() { entries.count.data[2] += flushes != flushed || entries.count.data[0] > waiting; }
    inline void shadow(int tile, unsigned rays) { entries.hidden.data[tile] |= (int)rays; }
    // All rays of a tile are in shadow.
    inline void accept(int tile) {
        const unsigned live = (unsigned)tiles.live.data[tile];
        if (!live)
            return;
        ++accepted;
        shadow(tile, live);
        tiles.live.data[tile] = 0;
        TileBox::remove(tiles.boxes, tile);
    }
    static inline Filter16 filter(const float* record, const float* rays) {
        return Filter16(record, Lanes16::load(rays), Lanes16::load(rays + 16), Lanes16::load(rays + 32),
                        Lanes16::load(rays + 48));
    }
    // Of each ray its own.
    static inline void bounds(const float* record, const float* rays, float more, Real16& edge, Real16& depth) {
        const Real16 m =
            Magnitudes16::of(Lanes16::load(rays), Lanes16::load(rays + 16), Lanes16::load(rays + 48)) + more;
        edge = Filter16::edge(record, m, Lanes16::load(rays + 32));
        depth = Filter16::depth(record, m);
    }
    // The rays of a tile, those that are `live`, and a triangle; returns those that are live behind it.
    inline unsigned test(int tile, int number, unsigned live) {
        const float *rays = TileMemory::rays(tiles, tile), *about = record(number);
        tests += __builtin_popcount(live);
        // One bound for all of them: it grows with the magnitude, so that of the largest holds for the others.
        const wp::vec2& most = TileMemory::magnitudes(tiles, tile);
        Real16 edge[2], depth[2];
        edge[0] = edge[1] = about[3] * most[1];
        depth[0] = depth[1] = about[7] * most[0] + about[11];
        if (Magnitudes16::apart(most))
            for (int half = 0; half < 2; ++half)
                bounds(about, rays + half * TileMemory::SIXTEEN_RAYS, most[1], edge[half], depth[half]);
        const Filter16 low = filter(about, rays), high = filter(about, rays + TileMemory::SIXTEEN_RAYS);
        const unsigned found =
            ((unsigned)low.possible(edge[0], depth[0]) | (unsigned)high.possible(edge[1], depth[1]) << 16) & live;
        if (!found)
            return live;
        const unsigned yes =
            ((unsigned)low.certain(edge[0], depth[0]) | (unsigned)high.certain(edge[1], depth[1]) << 16) & found;
        for (unsigned maybe = found & ~yes; maybe; maybe &= maybe - 1)
            if (Settle::pair(answers, TileMemory::ray_of(tiles, TileMemory::piece(tiles, tile), __builtin_ctz(maybe)),
                             triangle(number)))
                live &= ~(maybe & -maybe);
        shadow(tile, yes);
        return live & ~yes;
    }
    inline void keep(int tile, unsigned live) {
        if (live == (unsigned)tiles.live.data[tile])
            return;
        tiles.live.data[tile] = (int)live;
        if (!live)
            TileBox::remove(tiles.boxes, tile);
    }
    inline void test_tile(int tile, const int* records, int n) {
        unsigned live = (unsigned)tiles.live.data[tile];
        for (int k = 0; k < n && live; ++k) {
            if (k + AHEAD < n)
                __builtin_prefetch(record(records[k + AHEAD]));
            live = test(tile, records[k], live);
        }
        keep(tile, live);
    }
    // Traces what is in the list behind its first `from` entries, in order: for few triangles, whose records are near.
    inline void trace_behind(int from) {
        const int n = entries.count.data[0];
        for (int k = from; k < n; ++k) {
            const int tile = entries.tile.data[k];
            ++entries.total.data[tile];
            keep(tile, test(tile, entries.record.data[k], (unsigned)tiles.live.data[tile]));
        }
        entries.count.data[0] = from;
    }
    // Traces what is in the list.
    inline void flush() {
        ++flushes;
        const int n = entries.count.data[0], slots = 16 * tiles.counts.data[ALL_BLOCKS];
        if (n == 0)
            return;
        if (n < slots / TILES_PER_ENTRY) {
            trace_behind(0);
            return;
        }
        entries.count.data[0] = 0;
        int* start = entries.start.data;
        for (int k = 0; k <= slots; ++k)
            start[k] = 0;
        for (int k = 0; k < n; ++k)
            ++start[entries.tile.data[k]];
        int sum = 0;
        for (int k = 0; k < slots; ++k) {
            const int here = start[k];
            start[k] = sum;
            sum += here;
        }
        for (int k = 0; k < n; ++k)
            entries.sorted.data[start[entries.tile.data[k]]++] = entries.record.data[k];
        int from = 0;
        for (int tile = 0; tile < slots; ++tile) {
            const int to = start[tile];
            if (to > from) {
                entries.total.data[tile] += to - from;
                test_tile(tile, entries.sorted.data + from, to - from);
            }
            from = to;
        }
    }
    inline void enter(int tile, int record) {
        if (entries.count.data[0] == entries.capacity) {
            flush();
            if (!tiles.live.data[tile])
                return;
            ++entries.count.data[1];
        }
        const int slot = entries.count.data[0]++;
        entries.tile.data[slot] = tile;
        entries.record.data[slot] = record;
        ++entered;
    }
    // As many entries as bits are set in `hit`: tiles from `tile` on and one record, or one tile and records from
    // `record` on. The list has room for sixteen beyond its capacity.
    inline void enter_tiles(int tile, int hit, int record) {
        const int to = room_for(hit);
        if (to < 0) {
            for (; hit; hit &= hit - 1)
                enter(tile + __builtin_ctz(hit), record);
            return;
        }
        Compress::numbers(entries.tile.data + to, hit, tile);
        Compress::fill(entries.record.data + to, record);
    }
    inline void enter_records(int tile, int hit, int record) {
        const int to = room_for(hit);
        if (to < 0) {
            for (; hit && tiles.live.data[tile]; hit &= hit - 1)
                enter(tile, record + __builtin_ctz(hit));
            return;
        }
        Compress::numbers(entries.record.data + to, hit, record);
        Compress::fill(entries.tile.data + to, tile);
    }
    // Where they go; below zero if they do not fit, and go one by one.
    inline int room_for(int hit) {
        const int n = __builtin_popcount(hit), behind = entries.count.data[0];
        if (behind + n > entries.capacity)
            return -1;
        entries.count.data[0] = behind + n;
        entered += n;
        return behind;
    }
    inline void report() {
        wp::int64* counter = answers.counters.data;
        wp::atomic_add(counter + LEAF_TESTS, tests);
        wp::atomic_add(counter + ACCEPTED, accepted);
    }
    static inline void finish(const Tiles& tiles, const EntryList& entries, const Answers& answers) {
        Entries it(tiles, entries, answers);
        it.flush();
        it.report();
        Hidden::write_all(tiles, answers, entries.hidden, 16 * tiles.counts.data[ALL_BLOCKS]);
    }
};
