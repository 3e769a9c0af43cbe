// cpu
// needs: device/lanes.h@16
// constants: FACES FIT_CELLS GROUP_COLUMNS RAYS_OF
// arguments: LightFrame frame, Tiles tiles, Clusters clusters
// The pyramid of the rays of a face, against clusters of triangles; candidates.py derives the slacks.
struct Pyramid {
    typedef double Double16 __attribute__((ext_vector_type(16)));
    enum { PLANES = 7 };
    struct Plane {
        double normal[3], constant, slack;
    };
    Plane planes[PLANES];
    int count;

    // The sixteen clusters that one of the planes has all of outside, as bits. NaN is never rejected.
    static inline int outside(const Plane& p, const Double16 (&low)[3], const Double16 (&high)[3],
                              const Double16 (&most)[3]) {
        Double16 value = p.constant, size = p.slack;
        for (int k = 0; k < 3; ++k) {
            value += p.normal[k] * (p.normal[k] >= 0.0 ? high[k] : low[k]);
            size += fabs(p.normal[k]) * most[k];
        }
        const auto beyond = value < -0x1p-40 * size;
        return Lanes16::bits(__builtin_convertvector(beyond, Mask16));
    }
    inline int inside(int some, const Double16 (&low)[3], const Double16 (&high)[3], const Double16 (&most)[3]) const {
        for (int q = 0; q < PLANES && some; ++q)
            some &= ~outside(planes[q], low, high, most);
        return some;
    }
};
// U, V, W, Z of a point of the world: three factors and a constant, and the magnitude of what that is a sum of.
struct WorldToLight {
    double factor[4][3], constant[4], magnitude[4];

    inline WorldToLight(const LightFrame& frame) {
        for (int c = 0; c < 4; ++c) {
            const wp::vec3d& along = c == 0 ? frame.r : c == 1 ? frame.s : frame.f;
            const double scale = c == 2 ? -frame.w_slope * frame.inverse_scale : frame.inverse_scale;
            constant[c] = c == 2 ? frame.w_constant : 0.0;
            magnitude[c] = constant[c];
            for (int k = 0; k < 3; ++k) {
                factor[c][k] = scale * along[k];
                constant[c] -= factor[c][k] * frame.center[k];
                magnitude[c] += fabs(factor[c][k] * frame.center[k]);
            }
        }
    }
    // x of one component, y of another and z: what is not negative at any occluding point.
    inline void add(Pyramid& to, int one, double x, int other, double y, double z) const {
        Pyramid::Plane& p = to.planes[to.count++];
        for (int k = 0; k < 3; ++k)
            p.normal[k] = x * factor[one][k] + y * factor[other][k];
        p.constant = x * constant[one] + y * constant[other] + z;
        p.slack = 1.0 + fabs(x) * magnitude[one] + fabs(y) * magnitude[other] + fabs(z);
    }
    inline void make(Pyramid& to, int face, const wp::vec4& fit, const wp::vec2& far, const LightFrame& frame) const {
        const int axis = face >> 1, depth = 3;
        const double sign = face & 1 ? -1.0 : 1.0, cells = FIT_CELLS;
        to.count = 0;
        for (int q = 0; q < 2; ++q) {
            const double low = fit[q], high = low + cells / fit[2 + q];
            add(to, (axis + 1 + q) % 3, 1.0, axis, -sign * (low - 0x1p-20 * (1.0 + fabs(low))), 0.0);
            add(to, (axis + 1 + q) % 3, -1.0, axis, sign * (high + 0x1p-20 * (1.0 + fabs(high))), 0.0);
        }
        add(to, axis, sign, axis, 0.0, 0.0);
        add(to, axis, -sign, axis, 0.0, far[0]);
        const double light = frame.w_slope > 0.0 ? frame.w_constant / frame.w_slope : HUGE_VAL;
        add(to, depth, 1.0, depth, 0.0, -(light < far[1] ? light - 0x1p-20 * fabs(light) : far[1]));
    }
};
struct Candidates16 {
    // Stores the clusters that may concern the rays of the light at `place`, ascending, from `first` on; returns the
    // end. faces: of each, those whose rays it may concern, as bits.
    static inline int list(int place, int first, const LightFrame& frame, const Tiles& tiles, const Clusters& clusters,
                           const wp::array_t<int>& found, const wp::array_t<wp::uint8>& faces) {
        enum { SIXTEEN_BOXES = 16 * 6 };
        typedef Pyramid::Double16 Double16;
        const int items = (clusters.triangles + 255) / 256, count = (clusters.triangles + 15) / 16;
        const WorldToLight space(frame);
        Pyramid pyramids[FACES];
        int used = 0, end = first, face_of[FACES], seen[FACES];
        for (int face = 0; face < FACES; ++face) {
            const int number = FACES * place + face;
            if (tiles.groups.data[GROUP_COLUMNS * number + RAYS_OF] == 0)
                continue;
            space.make(pyramids[used], face, tiles.fit.data[number], tiles.far.data[number], frame);
            face_of[used++] = face;
        }
        for (int item = 0; item < items; ++item) {
            const float* box = clusters.boxes.data + SIXTEEN_BOXES * (size_t)item;
            Double16 low[3], high[3], most[3];
            for (int k = 0; k < 3; ++k) {
                low[k] = __builtin_convertvector(Lanes16::load(box + 16 * k), Double16);
                high[k] = __builtin_convertvector(Lanes16::load(box + 16 * (3 + k)), Double16);
                most[k] = high[k] > -low[k] ? high[k] : -low[k];
            }
            int any = 0;
            for (int f = 0; f < used; ++f)
                any |= seen[f] = pyramids[f].inside(0xFFFF, low, high, most);
            for (; any; any &= any - 1) {
                const int lane = __builtin_ctz(any), cluster = 16 * item + lane;
                if (cluster >= count)
                    break;
                int bits = 0;
                for (int f = 0; f < used; ++f)
                    bits |= (seen[f] >> lane & 1) << face_of[f];
                found.data[end] = cluster;
                faces.data[end++] = (wp::uint8)bits;
            }
        }
        return end;
    }
};
