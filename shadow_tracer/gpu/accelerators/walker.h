// needs: query walk
// arguments: Structure structure, Asked asked
// lanes
// Sends rays through a structure, LANES together.
struct WIDE(Walker) {
    // Numbers of rays, in turn. Of an image, for rays that go together: tiles of four by four pixels of each four rows;
    // as they are where there is no room for that.
    struct Order {
        enum { SIDE = 4 };
        const int width, count, tiled; // tiled: those of four rows that are in tiles
        int base, within;              // the first of four rows, and how many of them have been
        bool whole;

        inline Order(int first, int width, int count)
            : width(width), count(count), tiled(width / SIDE * SIDE * SIDE), base(0), within(first), whole(false) {
            if (width > 0) {
                within = first % (SIDE * width);
                base = first - within;
                whole = base + SIDE * width <= count;
            }
        }
        // At most `most` of them, of which there are some; returns how many.
        inline int some(int* numbers, int most) {
            if (!whole || within % (SIDE * SIDE) || within + SIDE * SIDE > tiled || most < SIDE * SIDE) {
                numbers[0] = next();
                return 1;
            }
            const int begin = base + within / SIDE;
            for (int j = 0; j < SIDE * SIDE; ++j)
                numbers[j] = begin + j / SIDE * width + j % SIDE;
            within += SIDE * SIDE - 1;
            next();
            return SIDE * SIDE;
        }
        inline int next() {
            const int k = within++;
            int number = base + k;
            if (whole && k < tiled)
                number = base + (k >> 2 & 3) * width + (k >> 4) * SIDE + (k & 3);
            else if (whole)
                number = base + (k - tiled) / (width % SIDE) * width + tiled / SIDE + (k - tiled) % (width % SIDE);
            if (width > 0 && within == SIDE * width) {
                base += within;
                within = 0;
                whole = base + SIDE * width <= count;
            }
            return number;
        }
    };
    static inline void go(const Structure& structure, WIDE(Query) & query) {
        query.begin();
        WIDE(Walk)::walk(structure, query);
        query.end();
    }
    // Those from `first` to `last`.
    static inline void some(int first, int last, int row, const Structure& structure, const Asked& asked) {
        WIDE(Query) query(asked);
#if LANES > 1
        Order order(first, asked.width, query.count());
#endif
        for (int ray = first; ray < last;) {
#if LANES > 1
            int numbers[Order::SIDE * Order::SIDE];
            const int count = order.some(numbers, last - ray);
#else
            const int numbers[1] = { ray }, count = 1;
#endif
            ray += count;
#if LANES > 1
            if (count == LANES && query.take_all(numbers)) {
                go(structure, query);
                continue;
            }
#endif
            for (int j = 0; j < count; ++j) {
                query.take(numbers[j]);
                if (query.taken && (query.full() || (ray == last && j + 1 == count)))
                    go(structure, query);
            }
        }
        query.report(row);
    }
};
