// cpu
// needs: accelerators/light_grid/pieces16.h accelerators/light_grid/counting.h accelerators/light_grid/keys.h@16
// constants: FACES FORWARD TILE_RAYS V_BITS FIT_CELLS NO_GROUP SEVERAL_FACES POOL_CELLS
// arguments: Tiles tiles, Pieces pieces
// Pieces whose rays the light sees far apart are taken to pieces again: their rays are sorted as those of one pool.
struct Pool16 {
    enum { ACROSS = POOL_CELLS + 1 };
    // Rays of a face below and left of each corner of equal cells.
    struct Table {
        int* sum;
        wp::vec4 fit;
        float scale_u, scale_v;

        inline Table(const Pieces& pieces, const wp::vec4& fit)
            : sum(pieces.table.data), fit(fit), scale_u(fit[2] * ((float)POOL_CELLS / (float)FIT_CELLS)),
              scale_v(fit[3] * ((float)POOL_CELLS / (float)FIT_CELLS)) {
            for (int k = 0; k < ACROSS * ACROSS; ++k)
                sum[k] = 0;
        }
        static inline int cell(float x) {
            const float last = POOL_CELLS - 1;
            return (int)(x > 0.0f ? (x < last ? x : last) : 0.0f);
        }
        inline void add(const float* box, int rays) {
            const int x = cell((0.5f * (box[0] + box[3]) - fit[0]) * scale_u);
            const int y = cell((0.5f * (box[1] + box[4]) - fit[1]) * scale_v);
            sum[ACROSS * (y + 1) + x + 1] += rays;
        }
        inline void sum_up() {
            for (int y = 1; y < ACROSS; ++y)
                for (int x = 1; x < ACROSS; ++x)
                    sum[ACROSS * y + x] +=
                        sum[ACROSS * y + x - 1] + sum[ACROSS * (y - 1) + x] - sum[ACROSS * (y - 1) + x - 1];
        }
        // About how many rays a box holds, if they are spread evenly over the cells it touches.
        inline float rays(const float* box) const {
            const float u0 = (box[0] - fit[0]) * scale_u, u1 = (box[3] - fit[0]) * scale_u, least = 0x1p-10f;
            const float v0 = (box[1] - fit[1]) * scale_v, v1 = (box[4] - fit[1]) * scale_v;
            const float wide = u1 - u0 > least ? u1 - u0 : least, high = v1 - v0 > least ? v1 - v0 : least;
            const int x0 = cell(u0), x1 = cell(u1) + 1, y0 = cell(v0), y1 = cell(v1) + 1;
            const int* lower = sum + ACROSS * y0;
            const int* upper = sum + ACROSS * y1;
            return (float)(upper[x1] - upper[x0] - lower[x1] + lower[x0]) * wide * high
                   / (float)((x1 - x0) * (y1 - y0));
        }
        // Along which axis a box is longer.
        inline int longer(const float* box) const { return (box[4] - box[1]) * scale_v > (box[3] - box[0]) * scale_u; }
    };
    // Makes two pieces of one, of the rays before and behind its middle, if that leaves of its box but a part.
    static inline bool split(int piece, float before, bool inverse, const Table& table, const Tiles& tiles,
                             const Pieces& pieces) {
        const int other = pieces.count.data[0];
        if (other >= pieces.room)
            return false;
        float boxes[2][6], *box = Pieces16::at_box(pieces, piece);
        const int axis = table.longer(box);
        const unsigned below = Pieces16::halve(piece, axis, 0.5f * (box[axis] + box[3 + axis]), inverse, tiles, pieces,
                                               boxes[0], boxes[1]);
        const unsigned above = (unsigned)pieces.live.data[piece] & ~below;
        if (!below || !above)
            return false;
        const float one = table.rays(boxes[0]), two = table.rays(boxes[1]), most = pieces.limit;
        if (one > most || two > most || one + two > 0.5f * before)
            return false;
        memcpy(box, boxes[0], sizeof(boxes[0]));
        memcpy(Pieces16::at_box(pieces, other), boxes[1], sizeof(boxes[1]));
        pieces.live.data[piece] = (int)below;
        pieces.live.data[other] = (int)above;
        pieces.group.data[other] = pieces.group.data[piece];
        tiles.numbers.data[other] = tiles.numbers.data[piece];
        pieces.count.data[0] = other + 1;
        return true;
    }
    // Splits or lists the pieces of a light that are large, from `found` on; returns the end.
    static inline int list(int place, int inverse, int found, const Tiles& tiles, const Pieces& pieces) {
        const int first = place * pieces.of_light, end = first + pieces.of_light;
        for (int number = FACES * place; number < FACES * (place + 1); ++number) {
            if (tiles.fit.data[number][2] == 0.0f || pieces.loose)
                continue;
            Table table(pieces, tiles.fit.data[number]);
            for (int piece = first; piece < end; ++piece) {
                if (pieces.group.data[piece] != number)
                    continue;
                table.add(Pieces16::at_box(pieces, piece), __builtin_popcount(pieces.live.data[piece]));
            }
            table.sum_up();
            for (int piece = first; piece < end; ++piece) {
                if (pieces.group.data[piece] != number)
                    continue;
                const float rays = table.rays(Pieces16::at_box(pieces, piece));
                if (2.0f * rays > pieces.limit && !split(piece, rays, inverse != 0, table, tiles, pieces)
                    && rays > pieces.limit)
                    pieces.pool.data[found++] = piece;
            }
        }
        for (int piece = first; piece < end; ++piece)
            if (pieces.group.data[piece] == SEVERAL_FACES)
                pieces.pool.data[found++] = piece;
        return found;
    }
    // Takes the listed pieces from `from` to `to`, those of one light, apart: keys and numbers of their rays behind the
    // first `count`, and the rays where they are found by number; returns how many there are now.
    static inline int take_apart(int place, int from, int to, int count, const Tiles& tiles, const Pieces& pieces,
                                 const wp::array_t<int>& cells, const wp::array_t<int>& keys,
                                 const wp::array_t<int>& order) {
        const bool aligned = tiles.aligned.data[place] != 0;
        const wp::vec4* fit = tiles.fit.data + FACES * place;
        OnFace16 at;
        for (int k = from; k < to; ++k) {
            const int piece = pieces.pool.data[k];
            pieces.group.data[piece] = NO_GROUP;
            for (int half = 0; half < 2; ++half) {
                const Lanes32 ray = Lanes32::of(tiles, pieces, piece, half);
                Real16 grid[4];
                for (int q = 0; q < 4; ++q)
                    grid[q] = fit[FORWARD][q];
                if (aligned) {
                    at.forward(ray.U, ray.V, ray.W);
                } else {
                    at.look(ray.U, ray.V, ray.W);
                    for (int face = 0; face < FACES; ++face)
                        for (int q = 0; q < 4; ++q)
                            grid[q] = at.face == face ? Real16(fit[face][q]) : grid[q];
                }
                const Mask16 key = Keys16::make(place, at, grid[0], grid[1], grid[2], grid[3]);
                int code[16];
                memcpy(code, &key, sizeof(code));
                unsigned take = (unsigned)pieces.live.data[piece] >> 16 * half & 0xFFFF;
                for (; take; take &= take - 1) {
                    const int j = __builtin_ctz(take), number = TileMemory::ray_of(tiles, piece, 16 * half + j);
                    if (!pieces.loose)
                        pieces.rays.data[number] = TileMemory::ray(tiles, piece, 16 * half + j);
                    keys.data[count] = code[j];
                    order.data[count++] = number;
                    ++cells.data[code[j] >> V_BITS];
                }
            }
        }
        return count;
    }
    // Rays of a column of the pool: a multiple of those of a piece, such that pieces are about square.
    static inline int column_length(int rays, const wp::vec4& fit) {
        const float aspect = fit[2] / fit[3], square = aspect < 0.125f ? 0.125f : aspect > 8.0f ? 8.0f : aspect;
        const int pieces = (int)sqrtf((float)rays / (float)TILE_RAYS * square);
        return TILE_RAYS * (pieces < 1 ? 1 : pieces);
    }
    // The rays of group `number`, order[begin:end] with cells of v in `keys`, as new pieces: the first of them take the
    // places of the listed ones, `bad` in number. `made`: pieces that have been made; returns how many there are now.
    static inline int put_together(int number, int inverse, int begin, int end, int made, int bad, const Tiles& tiles,
                                   const Pieces& pieces, const wp::array_t<int>& keys, const wp::array_t<int>& order) {
        const int length = column_length(end - begin, tiles.fit.data[number]);
        for (int from = begin; from < end; from += length) {
            const int to = from + length < end ? from + length : end;
            int* sorted = tiles.order.data + pieces.pool_order + TILE_RAYS * (size_t)made;
            Counting::sort(to - from, keys.data + from, order.data + from, sorted);
            for (int k = 0; k < to - from; k += TILE_RAYS, ++made) {
                const int used = to - from - k < TILE_RAYS ? to - from - k : TILE_RAYS;
                for (int j = k + 2 * TILE_RAYS; j < k + 3 * TILE_RAYS && j < to - from; ++j)
                    __builtin_prefetch(pieces.rays.data + sorted[j]);
                const int piece = made < bad ? pieces.pool.data[made] : pieces.count.data[0]++;
                for (int j = used; j < TILE_RAYS; ++j)
                    sorted[k + j] = sorted[k];
                tiles.numbers.data[piece] = wp::vec3i(piece, pieces.pool_order + TILE_RAYS * made, 0);
                pieces.live.data[piece] = (int)(0xFFFFFFFFu >> (TILE_RAYS - used));
                float* lanes = TileMemory::lanes(tiles, piece);
                Magnitudes16 magnitudes;
                for (int half = 0; half < 2; ++half, lanes += TileMemory::SIXTEEN_RAYS) {
                    for (int j = 0; j < 16; ++j)
                        for (int q = 0; q < 4; ++q)
                            lanes[16 * q + j] = pieces.rays.data[sorted[k + 16 * half + j]][q];
                    const Lanes32 it(lanes);
                    magnitudes.take(Pieces16::live(pieces, piece, half), it.U, it.V, it.W, it.Z);
                }
                magnitudes.store(tiles, piece, pieces.more.data[number / FACES]);
                Pieces16::bound(number, inverse != 0, piece, tiles, pieces);
            }
        }
        return made;
    }
};
