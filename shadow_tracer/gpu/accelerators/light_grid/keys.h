// needs: accelerators/light_grid/on_face.h
// constants: FACES FIT_BITS U_BITS V_BITS
// arguments: Tiles tiles
// lanes
// Keys of LANES rays: group, cell of u, cell of v.
struct WIDE(Keys) {
    static inline MASK cell(REAL x, REAL low, REAL scale) {
        const REAL at = (x - low) * scale, none = 0.0f, last = (1 << FIT_BITS) - 1;
        return WIDE(Lanes)::integer(at > none ? (at < last ? at : last) : none);
    }
    static inline MASK make(int place, const WIDE(OnFace) & at, REAL low_u, REAL low_v, REAL scale_u, REAL scale_v) {
        const MASK x = cell(at.u, low_u, scale_u) >> (FIT_BITS - U_BITS);
        const MASK y = cell(at.v, low_v, scale_v) >> (FIT_BITS - V_BITS);
        return ((FACES * place + at.face) << (U_BITS + V_BITS)) | (x << V_BITS) | y;
    }
#if LANES == 1
    static inline int of(int place, const wp::vec4& ray, const Tiles& tiles) {
        OnFace1 at;
        if (tiles.aligned.data[place] != 0)
            at.forward(ray[0], ray[1], ray[2]);
        else
            at.look(ray[0], ray[1], ray[2]);
        const wp::vec4& fit = tiles.fit.data[FACES * place + at.face];
        return make(place, at, fit[0], fit[1], fit[2], fit[3]);
    }
#endif
};
