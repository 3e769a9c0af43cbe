// needs: exact/arithmetic.h
// constants: LIT OUTSIDE INVALID
// arguments: LightFrame frame
// A sample's ray in the frame of a light, and its state before any triangle. None of it is contracted: the same bits
// everywhere.
struct Projected {
    float u, v, w, z;
    int state;
    int ray; // whether there is one; else u is NaN
};
// A light, without branches: one at infinity differs only in w = 0; the way to it is the same from everywhere, l - 0 p,
// and its distance has no end.
struct View : Arithmetic {
    double lx, ly, lz, lw, ax, ay, az, cosine, reach;
    double rx, ry, rz, sx, sy, sz, fx, fy, fz, cx, cy, cz, scale, w_constant, w_slope;

    inline explicit View(const LightFrame& frame) {
        lx = frame.light[0], ly = frame.light[1], lz = frame.light[2], lw = frame.light[3];
        ax = frame.axis[0], ay = frame.axis[1], az = frame.axis[2], cosine = frame.cosine;
        reach = lw != 0.0 ? frame.reach : HUGE_VAL;
        rx = frame.r[0], ry = frame.r[1], rz = frame.r[2];
        sx = frame.s[0], sy = frame.s[1], sz = frame.s[2];
        fx = frame.f[0], fy = frame.f[1], fz = frame.f[2];
        cx = frame.center[0], cy = frame.center[1], cz = frame.center[2];
        scale = frame.inverse_scale, w_constant = frame.w_constant, w_slope = frame.w_slope;
    }
    inline Projected of(double px, double py, double pz, double bias, int valid) const {
        const double infinity = HUGE_VAL, nan = infinity - infinity, endless = 1.7976931348623157e308;
        const int bounded = lw != 0.0;
        const double x = sub(lx, mul(lw, px)), y = sub(ly, mul(lw, py)), z = sub(lz, mul(lw, pz));
        const double length = norm(x, y, z);
        const double along = -add(add(mul(x, ax), mul(y, ay)), mul(z, az));
        const int out = bounded & ((length > reach) | (along < mul(cosine, length)));
        const double inverse = length > 0.0 ? 1.0 / length : 0.0;
        // Nothing lies between a biased start beyond the light and the light. Such a start would turn the filter's
        // planes around, so there is no ray, and the sample stays lit as the exact decision has it.
        const double distance = bounded ? length : endless;
        const int ray = valid & (1 - out) & (bias < distance);
        const double qx = mul(add(sub(px, cx), mul(mul(x, inverse), bias)), scale);
        const double qy = mul(add(sub(py, cy), mul(mul(y, inverse), bias)), scale);
        const double qz = mul(add(sub(pz, cz), mul(mul(z, inverse), bias)), scale);
        double u = add(add(mul(rx, qx), mul(ry, qy)), mul(rz, qz));
        double v = add(add(mul(sx, qx), mul(sy, qy)), mul(sz, qz));
        double h = add(add(mul(fx, qx), mul(fy, qy)), mul(fz, qz));
        double w = sub(w_constant, mul(w_slope, h));
        // The sum above may cancel beyond the bound of the filter; infinity is a maybe for everything.
        const double size = add(add(add(absolute(u), absolute(v)), absolute(w)), absolute(h));
        const bool far = mul(bias, scale) > add(0.5, size);
        u = far ? infinity : u;
        v = far ? infinity : v;
        w = far ? infinity : w;
        h = far ? infinity : h;
        const int state = valid ? (out ? OUTSIDE : LIT) : INVALID;
        return { (float)(ray ? u : nan), (float)v, (float)w, (float)h, state, ray };
    }
};
