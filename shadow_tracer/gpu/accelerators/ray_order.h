// cpu
// needs: accelerators/ray_keys.h@16
// constants: CURVE_BITS IN_TREE SHADOWED
// All rays of a light, sixteen at a time.
struct RayOrder {
    enum { FACES = 6 };
    const int count;
    const wp::array_t<wp::vec4>& rays;
    const wp::array_t<wp::uint8>& group;
    OnCube16 at;
    int taken[16];

    // Those from `base` on that are in the tree; false if none is. Lanes behind the last sample repeat the first.
    inline bool look(int base) {
        const int n = count - base < 16 ? count - base : 16;
        int any = 0;
        for (int j = 0; j < 16; ++j)
            taken[j] = 0;
        for (int j = 0; j < n; ++j)
            taken[j] = group.data[base + j] == IN_TREE;
        for (int j = 0; j < 16; ++j)
            any |= taken[j];
        if (!any)
            return false;
        const float* from = (const float*)(rays.data + base);
        float x[16], y[16], z[16];
        if (n == 16)
            for (int j = 0; j < 16; ++j)
                x[j] = from[4 * j], y[j] = from[4 * j + 1], z[j] = from[4 * j + 2];
        else
            for (int j = 0; j < 16; ++j)
                x[j] = from[j < n ? 4 * j : 0], y[j] = from[j < n ? 4 * j + 1 : 1], z[j] = from[j < n ? 4 * j + 2 : 2];
        at.look(Lanes16::load(x), Lanes16::load(y), Lanes16::load(z));
        return true;
    }
    static inline void measure(int count, const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& group,
                               const wp::array_t<float>& extent) {
        RayOrder it = { count, rays, group };
        float low_u[FACES], low_v[FACES], high_u[FACES], high_v[FACES];
        for (int k = 0; k < FACES; ++k) {
            low_u[k] = low_v[k] = 2.0f;
            high_u[k] = high_v[k] = -2.0f;
        }
        for (int base = 0; base < count; base += 16) {
            if (!it.look(base))
                continue;
            int face[16];
            float u[16], v[16];
            memcpy(face, &it.at.face, sizeof(face));
            memcpy(u, &it.at.u, sizeof(u));
            memcpy(v, &it.at.v, sizeof(v));
            for (int j = 0; j < 16; ++j) {
                if (!it.taken[j])
                    continue;
                const int k = face[j];
                low_u[k] = u[j] < low_u[k] ? u[j] : low_u[k];
                low_v[k] = v[j] < low_v[k] ? v[j] : low_v[k];
                high_u[k] = u[j] > high_u[k] ? u[j] : high_u[k];
                high_v[k] = v[j] > high_v[k] ? v[j] : high_v[k];
            }
        }
        for (int k = 0; k < FACES; ++k) {
            extent.data[4 * k] = low_u[k];
            extent.data[4 * k + 1] = low_v[k];
            extent.data[4 * k + 2] = high_u[k];
            extent.data[4 * k + 3] = high_v[k];
        }
    }
    static inline void pack(int count, const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& states,
                            const wp::array_t<wp::uint8>& group, const wp::array_t<wp::vec4>& fit,
                            const wp::array_t<int>& keys, const wp::array_t<int>& order,
                            const wp::array_t<int>& counts) {
        RayOrder it = { count, rays, group };
        int found = 0;
        for (int base = 0; base < count; base += 16) {
            if (!it.look(base))
                continue;
            int face[16];
            float low_u[16], low_v[16], scale[16];
            memcpy(face, &it.at.face, sizeof(face));
            for (int j = 0; j < 16; ++j) {
                const wp::vec4& grid = fit.data[face[j]];
                low_u[j] = grid[0], low_v[j] = grid[1], scale[j] = grid[2];
            }
            const Real16 per_unit = Lanes16::load(scale);
            const Mask16 key = (it.at.face << 2 * CURVE_BITS)
                               | CubeCell16::morton(CubeCell16::cell(it.at.u, Lanes16::load(low_u), per_unit),
                                                    CubeCell16::cell(it.at.v, Lanes16::load(low_v), per_unit));
            int code[16];
            memcpy(code, &key, sizeof(code));
            for (int j = 0; j < 16; ++j) {
                keys.data[found] = code[j];
                order.data[found] = base + j;
                found += it.taken[j] && states.data[base + j] != SHADOWED;
            }
        }
        counts.data[0] = found;
    }
};
