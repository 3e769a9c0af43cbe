// needs: device/lanes.h
// lanes
// Where LANES rays lie on the cube of directions: light_space.face_of and face_axes, and the two coordinates.
struct WIDE(OnCube) {
    MASK face; // 0 to 5 for +U, -U, +V, -V, +W, -W
    REAL size; // along the face's axis
    REAL u, v; // the other two coordinates, divided by it

    inline void look(REAL U, REAL V, REAL W) {
        typedef WIDE(Lanes) Lanes;
        const REAL x = Lanes::absolute(U), y = Lanes::absolute(V), z = Lanes::absolute(W), none = 0.0f;
        const MASK on_u = (x >= y) & (x >= z), on_v = y >= z, first = 0, second = 2, third = 4;
        const REAL major = on_u ? U : on_v ? V : W;
        face = (on_u ? first : on_v ? second : third) + ((major < none) & 1);
        size = Lanes::absolute(major);
        const REAL inverse = 1.0f / size;
        u = (on_u ? V : on_v ? W : U) * inverse;
        v = (on_u ? W : on_v ? U : V) * inverse;
    }
};
