// needs: device/lanes.h exact/faces.h@1 exact/planes.h@1 exact/box.h exact/light_space.h accelerators/cone_hierarchy/cells.h
// arguments: LightSpace space, RayTree tree, Occluders occluders
// lanes
// A triangle on its way through the ray tree, and LANES sibling boxes against it; see descent.py. Its corners are no
// member: they are indexed at run time, and what holds them lies in memory.
struct WIDE(Traveller) {
    const LightSpace& space;
    const RayTree& tree;
    const Occluders& occluders;
    Planes1 planes;
    float spread[4][3];             // absolute values of their normals
    float low[3], high[3], nearest; // its bounds on a face, as directions, and its largest depth there

    // Corners; returns the faces that it may touch, as bits.
    inline int look(int triangle, Corners1& corners) const {
        corners.gather(occluders.corners.data, occluders.triangles.data[triangle]);
        Corners1::Faces touched;
        int faces = 0;
        corners.touched(touched);
        for (int face = 0; face < Corners1::FACES; ++face)
            faces |= touched[face] << face;
        return faces;
    }
    // Planes; false if it casts nothing.
    inline bool load(int triangle) {
        planes.take((const float*)occluders.records.data + 16 * (size_t)triangle, 1, space);
        for (int k = 0; k < 4; ++k)
            for (int i = 0; i < 3; ++i)
                spread[k][i] = fabsf(k < 3 ? planes.n[k][i] : planes.p[i]);
        return !planes.silent;
    }
    // Whatever the direction and depth of rays.
    inline void open() {
        for (int k = 0; k < 3; ++k) {
            low[k] = -3.0f;
            high[k] = 3.0f;
        }
        nearest = 3.0e38f;
    }
    // Its bounds on a face, and the leaves that it may touch there; false if it cannot touch the face.
    inline bool enter(int face, const Corners1& corners, Runs& runs) {
        if (tree.fit.data[face][3] == 0.0f)
            return false;
        Seen1 seen;
        seen.open();
        if (seen.look(corners, face, space.inverse != 0))
            return false;
        runs.find(tree, seen, face);
        open();
        if (seen.bounded) {
            const int axis = face >> 1, first = (axis + 1) % 3;
            const float sign = face & 1 ? -1.0f : 1.0f;
            for (int k = 0; k < 3; ++k) {
                low[k] = k == axis ? sign : k == first ? seen.low_u : seen.low_v;
                high[k] = k == axis ? sign : k == first ? seen.high_u : seen.high_v;
            }
            nearest = seen.nearest;
        }
        return true;
    }
    // The boxes that it cannot be said to miss, as bits; covered: those of which it hides every ray.
    inline int judge(const float* box, int branch, int& covered) const {
        typedef WIDE(Lanes) Lanes;
        REAL c[3], e[3];
        for (int k = 0; k < 3; ++k) {
            c[k] = Lanes::load(box + k * branch);
            e[k] = Lanes::load(box + (3 + k) * branch);
        }
        const REAL none = 0.0f, least = Lanes::load(box + 6 * branch), most = Lanes::load(box + 7 * branch);
        covered = 0;
        if (planes.blind)
            return Lanes::bits(e[0] >= none);
        const int within = Lanes::bits((c[0] - e[0] <= high[0]) & (c[0] + e[0] >= low[0]) & (c[1] - e[1] <= high[1])
                                       & (c[1] + e[1] >= low[1]) & (c[2] - e[2] <= high[2]) & (c[2] + e[2] >= low[2])
                                       & (least <= nearest));
        if (LANES == 1 && !within)
            return 0;
        const REAL m = WIDE(LightDepth)::magnitude(least, most);
        REAL middle[4], reach[4];
        for (int k = 0; k < 4; ++k) {
            const float* n = k < 3 ? planes.n[k] : planes.p;
            middle[k] = n[0] * c[0] + n[1] * c[1] + n[2] * c[2];
            reach[k] = spread[k][0] * e[0] + spread[k][1] * e[1] + spread[k][2] * e[2];
        }
        return WIDE(Box)::judge(within, middle, reach, planes.p[3] * least, planes.p[3] * most, planes.edge * m,
                                planes.plane * m, covered);
    }
};
