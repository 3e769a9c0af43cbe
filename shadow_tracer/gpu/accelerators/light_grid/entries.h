// cpu
// needs: exact/filter.h@16 visibility/answers.h accelerators/light_grid/tiles.h
// constants: SHADOWED LEAF_TESTS ACCEPTED ALL_BLOCKS
// arguments: Tiles tiles, Occluders occluders, EntryList entries, Answers answers
// Entries gather in a list; whenever it is full, it is sorted by tile and traced, tile by tile, sixteen rays at a time.
struct Entries {
    // With fewer entries per tile than one in so many, sorting costs more than it gains.
    enum { TILES_PER_ENTRY = 8, AHEAD = 4 };
    const Tiles& tiles;
    const Occluders& occluders;
    const EntryList& entries;
    const Answers& answers;
    wp::int64 tests, accepted, entered;

    inline Entries(const Tiles& tiles, const Occluders& occluders, const EntryList& entries, const Answers& answers)
        : tiles(tiles), occluders(occluders), entries(entries), answers(answers), tests(0), accepted(0), entered(0) {}
    inline const float* record(int number) const { return (const float*)occluders.records.data + 16 * (size_t)number; }
    inline void shadow(int tile, unsigned rays) {
        const int* order = TileMemory::order(tiles, tile);
        for (; rays; rays &= rays - 1)
            answers.states.data[order[__builtin_ctz(rays)]] = SHADOWED;
    }
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
    inline void test_tile(int tile, const int* records, int n) {
        unsigned live = (unsigned)tiles.live.data[tile];
        const float* rays = TileMemory::rays(tiles, tile);
        for (int k = 0; k < n && live; ++k) {
            if (k + AHEAD < n)
                __builtin_prefetch(record(records[k + AHEAD]));
            tests += __builtin_popcount(live);
            int yes_low = 0, yes_high = 0;
            const unsigned low = live & 0xFFFF ? Filter16::possible(record(records[k]), rays, yes_low) : 0;
            const unsigned high =
                live >> 16 ? Filter16::possible(record(records[k]), rays + TileMemory::SIXTEEN_RAYS, yes_high) : 0;
            const unsigned found = (low | high << 16) & live;
            if (!found)
                continue;
            const unsigned yes = ((low ? yes_low : 0) | (high ? (unsigned)yes_high << 16 : 0)) & found;
            const int* order = TileMemory::order(tiles, tile);
            for (unsigned maybe = found & ~yes; maybe; maybe &= maybe - 1)
                if (Settle::pair(answers, order[__builtin_ctz(maybe)], records[k] % occluders.records_apart))
                    live &= ~(maybe & -maybe);
            shadow(tile, yes);
            live &= ~yes;
        }
        if (live != (unsigned)tiles.live.data[tile]) {
            tiles.live.data[tile] = (int)live;
            if (!live)
                TileBox::remove(tiles.boxes, tile);
        }
    }
    // Traces what is in the list.
    inline void flush() {
        const int n = entries.count.data[0], slots = 16 * tiles.counts.data[ALL_BLOCKS];
        if (n == 0)
            return;
        entries.count.data[0] = 0;
        ++entries.count.data[1];
        if (n < slots / TILES_PER_ENTRY) {
            for (int k = 0; k < n; ++k) {
                ++entries.total.data[entries.tile.data[k]];
                test_tile(entries.tile.data[k], entries.record.data + k, 1);
            }
            return;
        }
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
        }
        const int slot = entries.count.data[0]++;
        entries.tile.data[slot] = tile;
        entries.record.data[slot] = record;
        ++entered;
    }
    // The tiles of a block whose bits are set.
    inline void enter(int block, int hit, int record) {
        const int n = __builtin_popcount(hit), waiting = entries.count.data[0];
        if (waiting + n > entries.capacity) {
            for (; hit; hit &= hit - 1)
                enter(16 * block + __builtin_ctz(hit), record);
            return;
        }
        int *to_tile = entries.tile.data + waiting, *to_record = entries.record.data + waiting;
        for (; hit; hit &= hit - 1) {
            *to_tile++ = 16 * block + __builtin_ctz(hit);
            *to_record++ = record;
        }
        entries.count.data[0] = waiting + n;
        entered += n;
    }
    inline void report() {
        wp::int64* counter = answers.counters.data;
        wp::atomic_add(counter + LEAF_TESTS, tests);
        wp::atomic_add(counter + ACCEPTED, accepted);
    }
    static inline void finish(const Tiles& tiles, const Occluders& occluders, const EntryList& entries,
                              const Answers& answers) {
        Entries it(tiles, occluders, entries, answers);
        it.flush();
        it.report();
    }
};
