// needs: exact/pads.h
// lanes
// arguments: LightSpace space
// The four planes of triangles over light space, LANES at a time, from their records; light_space.py derives P and the
// pads.
struct WIDE(Planes) {
    typedef REAL Row[16]; // the numbers of a record
    REAL n[3][3];         // edges
    REAL p[4];            // P
    REAL edge, plane;     // factors of the pads
    int silent;           // the lanes of triangles that cast nothing, as bits
    int blind;            // those with a value that is not finite: no box may be judged by them

    // The planes of `count` records, which lie one after the other; lanes behind the last repeat the first.
    inline void take(const float* records, int count, const LightSpace& space) {
#if LANES == 1
        load(*(const Row*)records, space);
#else
        float row[16][LANES];
        if (count == LANES)
            for (int k = 0; k < 16; ++k)
                for (int j = 0; j < LANES; ++j)
                    row[k][j] = records[16 * j + k];
        else
            for (int k = 0; k < 16; ++k)
                for (int j = 0; j < LANES; ++j)
                    row[k][j] = records[16 * (j < count ? j : 0) + k];
        load(*(const Row*)row, space);
#endif
    }
    inline void load(const Row& row, const LightSpace& space) {
        typedef WIDE(Lanes) Lanes;
        silent = Lanes::bits((row[12] == 0.0f) & (row[13] == 0.0f) & (row[14] == 0.0f));
        REAL sum = 0.0f;
        for (int k = 0; k < 16; ++k)
            sum += Lanes::absolute(row[k]);
        blind = ~Lanes::bits(sum < 1.0e17f) & Lanes::ALL;
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 3; ++i)
                n[k][i] = row[4 * k + i];
        own(row[12], row[13], row[14], row[15], space, p);
        edge = WIDE(Pads)::edge(row[3]);
        plane = WIDE(Pads)::plane(row[7], row[11]);
    }
    // P of a record's own plane, (N, D).
    static inline void own(REAL u, REAL v, REAL z, REAL offset, const LightSpace& space, REAL (&p)[4]) {
        const bool inverse = space.inverse != 0;
        const REAL none = 0.0f, slope = inverse ? space.c * z - offset : z - space.s * offset;
        p[0] = u;
        p[1] = v;
        p[2] = inverse ? -z : -offset;
        p[3] = slope < none ? slope : none;
    }
};
