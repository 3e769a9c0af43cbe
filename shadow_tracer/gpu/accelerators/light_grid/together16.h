// cpu
// needs: accelerators/light_grid/entries.h accelerators/light_grid/side.h@16 device/compress.h
// constants: FIT_CELLS
// arguments: Tiles tiles, EntryList entries, Answers answers
// The sixteen triangles of a cluster against the tiles of a face, by flat lists: what is asked of a box is the same for
// all of them, and which of them go on is written behind a list instead of branched upon. Columns, blocks and tiles are
// looked at by bounds that hold those of the triangles; each tile that is left by the triangles' own, then by their
// planes. light_grid.md says why none is missed.
struct Together16 : Entries {
    // A cluster is loose, and its triangles go one by one, if its bounds have more than so many times the area of
    // theirs, each grown by a tile; a triangle is broad if it spans more than so much of the rays.
    enum { MANY = 256 };
    static inline float loose() { return 4.0f; }
    static inline float broad() { return 0.3f; }
    Side16 side;
    wp::int64 nodes;

    inline Together16(const Tiles& tiles, const EntryList& entries, const Answers& answers)
        : Entries(tiles, entries, answers), nodes(0) {}
    inline int touches(const wp::array_t<float>& boxes, int number) {
        nodes += 16;
        return side.touches(TileBox::at(boxes, number));
    }
    static inline float least(Real16 x) {
#define FOLDED(k) __builtin_shufflevector(x, x, HALF##k)
#define HALF8 8, 9, 10, 11, 12, 13, 14, 15, 8, 9, 10, 11, 12, 13, 14, 15
#define HALF4 4, 5, 6, 7, 4, 5, 6, 7, 4, 5, 6, 7, 4, 5, 6, 7
#define HALF2 2, 3, 2, 3, 2, 3, 2, 3, 2, 3, 2, 3, 2, 3, 2, 3
#define HALF1 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1
        x = Seen16::Corners::smaller(x, FOLDED(8));
        x = Seen16::Corners::smaller(x, FOLDED(4));
        x = Seen16::Corners::smaller(x, FOLDED(2));
        return Seen16::Corners::smaller(x, FOLDED(1))[0];
    }
    static inline float sum(Real16 x) {
        x += FOLDED(8);
        x += FOLDED(4);
        x += FOLDED(2);
        return (x + FOLDED(1))[0];
    }
#undef FOLDED
#undef HALF8
#undef HALF4
#undef HALF2
#undef HALF1
    // Those of `some` that are not broad, if their bounds lie close together, and then `side` has the bounds of them
    // all; else none.
    inline int gather(const TileGroup& group, const Seen16& seen, int some) {
        const Real16 scale_u = group.fit[2] / FIT_CELLS, scale_v = group.fit[3] / FIT_CELLS, none = 0.0f;
        const Real16 u = (seen.high_u - seen.low_u) * scale_u, v = (seen.high_v - seen.low_v) * scale_v;
        some &= seen.bounded & Lanes16::bits((u <= broad()) & (v <= broad()));
        if (!(some & (some - 1)))
            return 0;
        const Mask16 in = Lanes16::mask(some);
        const Real16 far = 3.0e38f;
        side.low_u = least(in ? seen.low_u : far);
        side.high_u = -least(in ? -seen.high_u : far);
        side.low_v = least(in ? seen.low_v : far);
        side.high_v = -least(in ? -seen.high_v : far);
        side.nearest = -least(in ? -seen.nearest : far);
        const float tile = 1.0f / sqrtf(16.0f * (float)group.blocks);
        const float parts = sum(in ? (u + tile) * (v + tile) : none);
        const float whole =
            ((side.high_u - side.low_u) * scale_u[0] + tile) * ((side.high_v - side.low_v) * scale_v[0] + tile);
        return whole <= loose() * parts ? some : 0;
    }
    // The tiles whose boxes the bounds in `side` touch; returns how many are listed in `visited`.
    inline int list_tiles(const TileGroup& group) {
        int *tile = entries.visited.data, *block = tile + entries.tile_places, from, to, blocks = 0, count = 0;
        group.columns(side.low_u, side.high_u, from, to);
        for (int column = from; column <= to; ++column)
            blocks += Compress::numbers(block + blocks, touches(tiles.blocks, 16 * (group.first_column + column)),
                                        group.first_block + column * group.length);
        for (int k = 0; k < blocks; ++k)
            count += Compress::numbers(tile + count, touches(tiles.boxes, 16 * block[k]), 16 * block[k]);
        return count;
    }
    // Keeps the first `count` tiles of the list that the bounds of any of `some` touch, and in `masks` which of them
    // do.
    inline int touched(const Seen16& seen, int some, int count) {
        int *tile = entries.visited.data, *mask = entries.masks.data, kept = 0;
        nodes += 16 * (wp::int64)count;
        for (int k = 0; k < count; ++k) {
            const float* box = TileBox::at(tiles.boxes, tile[k]);
            const Real16 cu = box[0], cv = box[16], eu = box[32], ev = box[48], t0 = box[64];
            tile[kept] = tile[k];
            mask[kept] = some
                         & Lanes16::bits((cu - eu <= seen.high_u) & (cu + eu >= seen.low_u) & (cv - ev <= seen.high_v)
                                         & (cv + ev >= seen.low_v) & (t0 <= seen.nearest));
            kept += mask[kept] != 0;
        }
        return kept;
    }
    // The planes of sixteen triangles as they stand on a face, for one box after the other.
    struct Faced {
        Real16 a[4], b[4], c[4], wide[4], high[4], slope, edge, plane;

        inline Faced(const Planes16& planes, int face) : slope(planes.p[3]), edge(-planes.edge), plane(-planes.plane) {
            const int axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
            const float sign = face & 1 ? -1.0f : 1.0f;
            for (int q = 0; q < 4; ++q) {
                const Real16(&n)[3] = q < 3 ? planes.n[q] : *(const Real16(*)[3])planes.p;
                a[q] = n[first];
                b[q] = n[second];
                c[q] = sign * n[axis];
                wide[q] = Lanes16::absolute(a[q]);
                high[q] = Lanes16::absolute(b[q]);
            }
        }
        // How far the box gets on the inner side of a plane.
        inline Real16 most(int q, Real16 cu, Real16 cv, Real16 eu, Real16 ev) const {
            CONTRACTED
            return a[q] * cu + (b[q] * cv + (wide[q] * eu + (high[q] * ev + c[q])));
        }
        // The triangles that cannot be said to miss the box, as bits; as Box16::judge has it for boxes.
        inline int meets(const float* box) const {
            CONTRACTED
            const Real16 cu = box[0], cv = box[16], eu = box[32], ev = box[48], t0 = box[64];
            const float s0 = fabsf(box[64]), s1 = fabsf(box[80]), m = 6.0f + 2.001f * (s0 > s1 ? s0 : s1);
            const Real16 beside = edge * m;
            return Lanes16::bits((most(0, cu, cv, eu, ev) >= beside) & (most(1, cu, cv, eu, ev) >= beside)
                                 & (most(2, cu, cv, eu, ev) >= beside)
                                 & (slope * t0 + most(3, cu, cv, eu, ev) >= plane * m));
        }
    };
    // Enters what the planes of the triangles cannot be said to miss, of the first `count` tiles.
    inline void enter_all(const Planes16& planes, int face, int count, int record) {
        const Faced faced(planes, face);
        const int *tile = entries.visited.data, *mask = entries.masks.data;
        int from = entries.count.data[0], before = flushes;
        for (int k = 0; k < count; ++k) {
            const float* rays = TileMemory::rays(tiles, tile[k]);
            for (int q = 0; q < TileMemory::RAYS; q += 16)
                __builtin_prefetch(rays + q);
            const float* box = TileBox::at(tiles.boxes, tile[k]);
            const int met = mask[k] & faced.meets(box);
            enter_records(tile[k], (met | (mask[k] & planes.blind)) & ~planes.silent, record);
            from = flushes == before ? from : 0;
            before = flushes;
            if (entries.count.data[0] - from >= MANY)
                trace_behind(from);
        }
        trace_behind(from);
    }
};
