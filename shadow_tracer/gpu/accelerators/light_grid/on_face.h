// needs: exact/cube.h exact/light_space.h
// constants: FORWARD
// lanes
// LANES rays on a face of a light.
struct WIDE(OnFace) : WIDE(OnCube) {
    typedef WIDE(Lanes) Lanes;
    // The rays that the aligned frustum holds.
    static inline MASK ahead(REAL U, REAL V, REAL W) {
        return (W > 0.0f) & (Lanes::absolute(U) <= 2.0f * W) & (Lanes::absolute(V) <= 2.0f * W);
    }
    // On one face, whichever it is.
    inline void set(int number, REAL major, REAL one, REAL two) {
        face = number;
        size = Lanes::absolute(major);
        const REAL inverse = 1.0f / size;
        u = one * inverse;
        v = two * inverse;
    }
    // In the aligned frustum.
    inline void forward(REAL U, REAL V, REAL W) { set(FORWARD, W, U, V); }
    // Depth of light space, with h divided by its coordinate along the face's axis.
    inline REAL depth(REAL Z, bool inverse) const { return WIDE(LightDepth)::of(Z, 1.0f / size, inverse); }
#if LANES == 1
    // (u, v, depth) of a ray; axes: light_space.face_axes of it.
    static inline wp::vec3 place(const wp::vec3& axes, float Z, int inverse) {
        OnFace1 at;
        at.set(0, axes[0], axes[1], axes[2]);
        return wp::vec3(at.u, at.v, at.depth(Z, inverse != 0));
    }
    static inline bool fits(const wp::vec4& ray) { return ahead(ray[0], ray[1], ray[2]) != 0; }
#endif
};
