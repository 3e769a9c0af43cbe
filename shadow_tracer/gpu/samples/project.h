// cpu
// constants: FIRST_TIME PENDING_RAYS PROJECT_BLOCK LIT OUTSIDE INVALID PENDING
// needs: exact/arithmetic.h
// arguments: LightFrame frame
// A light at infinity differs only in w = 0: the way to it is the same from everywhere, l - 0 p, and its distance has
// no end. States and rays of the block stay on the stack until it is known which of them are wanted.
struct Project : Arithmetic {
    static inline void block(int first, int count, const LightFrame& frame, int again, int column,
                             const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid,
                             const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& states,
                             const wp::array_t<wp::int64>& counters) {
        const int n = count - first < PROJECT_BLOCK ? count - first : PROJECT_BLOCK;
        int pending = again != PENDING_RAYS;
        for (int j = 0; j < n; ++j)
            pending |= states.data[first + j] == PENDING;
        if (!pending)
            return;
        const double lx = frame.light[0], ly = frame.light[1], lz = frame.light[2], lw = frame.light[3];
        const double ax = frame.axis[0], ay = frame.axis[1], az = frame.axis[2], cosine = frame.cosine;
        const double rx = frame.r[0], ry = frame.r[1], rz = frame.r[2];
        const double sx = frame.s[0], sy = frame.s[1], sz = frame.s[2];
        const double fx = frame.f[0], fy = frame.f[1], fz = frame.f[2];
        const double cx = frame.center[0], cy = frame.center[1], cz = frame.center[2];
        const double scale = frame.inverse_scale, w_constant = frame.w_constant, w_slope = frame.w_slope;
        const double endless = 1.7976931348623157e308, infinity = HUGE_VAL, nan = infinity - infinity;
        const double reach = lw != 0.0 ? frame.reach : infinity;
        const int bounded = lw != 0.0;
        typedef double Four[4];
        typedef float Ray[4];
        const Four* __restrict__ sample = (const Four*)(samples.data + first);
        const wp::uint8* __restrict__ good = valid.data + first;
        Ray* __restrict__ ray = (Ray*)(rays.data + first);
        wp::uint8 state[PROJECT_BLOCK];
        int traced = 0;
        for (int j = 0; j < n; ++j) {
            const double px = sample[j][0], py = sample[j][1], pz = sample[j][2], bias = sample[j][3];
            const double x = sub(lx, mul(lw, px)), y = sub(ly, mul(lw, py)), z = sub(lz, mul(lw, pz));
            const double length = norm(x, y, z);
            const double along = -add(add(mul(x, ax), mul(y, ay)), mul(z, az));
            const int out = bounded & ((length > reach) | (along < mul(cosine, length)));
            const double inverse = length > 0.0 ? 1.0 / length : 0.0;
            const double distance = bounded ? length : endless;
            const double qx = mul(add(sub(px, cx), mul(mul(x, inverse), bias)), scale);
            const double qy = mul(add(sub(py, cy), mul(mul(y, inverse), bias)), scale);
            const double qz = mul(add(sub(pz, cz), mul(mul(z, inverse), bias)), scale);
            double u = add(add(mul(rx, qx), mul(ry, qy)), mul(rz, qz));
            double v = add(add(mul(sx, qx), mul(sy, qy)), mul(sz, qz));
            double h = add(add(mul(fx, qx), mul(fy, qy)), mul(fz, qz));
            double w = sub(w_constant, mul(w_slope, h));
            const double size = add(add(add(absolute(u), absolute(v)), absolute(w)), absolute(h));
            const bool far = mul(bias, scale) > add(0.5, size);
            u = far ? infinity : u;
            v = far ? infinity : v;
            w = far ? infinity : w;
            h = far ? infinity : h;
            const int is = good[j] != 0;
            const int ray_ends = is & (1 - out) & (bias < distance);
            ray[j][0] = (float)(ray_ends ? u : nan);
            ray[j][1] = (float)v;
            ray[j][2] = (float)w;
            ray[j][3] = (float)h;
            state[j] = (wp::uint8)(is ? (out ? OUTSIDE : LIT) : INVALID);
            traced += ray_ends;
        }
        if (again == PENDING_RAYS)
            return;
        for (int j = 0; j < n; ++j)
            states.data[first + j] = state[j];
        if (again == FIRST_TIME)
            wp::atomic_add(&counters.data[((first / PROJECT_BLOCK) & 63) * counters.shape[1] + column],
                           (wp::int64)traced);
    }
};
