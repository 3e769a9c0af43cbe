// cpu
// needs: device/lanes.h@16 device/fold.h accelerators/light_grid/tiles.h
// constants: MAGNITUDE_FLOOR
// arguments: Tiles tiles
// What the bounds of the filter are made of, for all live rays of a piece: the largest magnitude, and with |W|; or
// infinity, where that would be much for some of them: then each has its own. All of it is with what is to be added to
// magnitudes, which then stands behind the infinity.
struct Magnitudes16 {
    enum { APART = 64 };
    Real16 most, with_w, least, least_with_w;

    inline Magnitudes16() {
        most = with_w = 0.0f;
        least = least_with_w = (float)HUGE_VAL;
    }
    static inline Real16 of(Real16 U, Real16 V, Real16 Z) {
        const Real16 floor = MAGNITUDE_FLOOR;
        return Lanes16::absolute(U) + Lanes16::absolute(V) + Lanes16::absolute(Z) + floor;
    }
    inline void take(Mask16 in, Real16 U, Real16 V, Real16 W, Real16 Z) {
        const Real16 m = of(U, V, Z), n = m + Lanes16::absolute(W);
        most = (in & (m > most)) ? m : most;
        with_w = (in & (n > with_w)) ? n : with_w;
        least = (in & (m < least)) ? m : least;
        least_with_w = (in & (n < least_with_w)) ? n : least_with_w;
    }
    // more: what is to be added.
    inline void store(const Tiles& tiles, int piece, float more = 0.0f) const {
        const float m = -Fold16::least(-most), n = -Fold16::least(-with_w), none = (float)HUGE_VAL;
        const bool apart = m > APART * Fold16::least(least) || n > APART * Fold16::least(least_with_w);
        tiles.magnitudes.data[tiles.numbers.data[piece][0]] =
            apart ? wp::vec2(none, more) : wp::vec2(m + more, n + more);
    }
    static inline bool apart(const wp::vec2& stored) { return stored[0] == (float)HUGE_VAL; }
};
