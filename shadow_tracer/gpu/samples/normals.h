// needs: exact/arithmetic.h exact/arithmetic32.h
// constants: NEAREST_MEASURED FARTHEST_MEASURED LARGEST_JUMP FLATTEST LARGEST_COORDINATE
// arguments: Pinhole camera
// The normal of scene/normals.py, in the same order of operations without contraction: the same bits.
struct Normal : Arithmetic, Arithmetic32 {
    static inline float invert(float x) {
#if defined(__CUDA_ARCH__)
        return __fdiv_rn(1.0f, x);
#else
        return 1.0f / x;
#endif
    }
    // Inverse depth, 0 where nothing was measured.
    static inline float inverse(float raw) {
        const bool is = raw >= (float)NEAREST_MEASURED && raw <= (float)FARTHEST_MEASURED;
        return is ? invert(is ? raw : 1.0f) : 0.0f;
    }
    // Whether a neighbour's inverse depth belongs to the surface of one that is s.
    static inline bool counts(float other, float difference, float s) {
        return (other > 0.0f) & (fabsf(difference) <= times((float)LARGEST_JUMP, s));
    }
    // The sums of a pixel's neighbours, its inverse depth s and its ray (across, down, 1) say where its sample is moved
    // to; false if there is no normal, or no room beyond.
    static inline bool move(const Pinhole& camera, const double* sample, float s, double across, double down, double w,
                            double x, double y, double xx, double xy, double yy, double d, double xd, double yd,
                            double* moved) {
        const double mxx = sub(mul(w, xx), mul(x, x)), myy = sub(mul(w, yy), mul(y, y));
        const double mxy = sub(mul(w, xy), mul(x, y));
        const double mxd = sub(mul(w, xd), mul(x, d)), myd = sub(mul(w, yd), mul(y, d));
        const double det = sub(mul(mxx, myy), mul(mxy, mxy)), share = mul(det, (double)s);
        const double a = sub(mul(myy, mxd), mul(mxy, myd)) / share, b = sub(mul(mxx, myd), mul(mxy, mxd)) / share;
        const double c = sub(sub(1.0, mul(a, across)), mul(b, down));
        const double length = norm(a, b, c), one = 1.0 / length;
        const double nx = mul(-a, one), ny = mul(-b, one), nz = mul(-c, one);
        const double wanted = mul(camera.bias_normal, sample[3]);
        const double far = wanted < LARGEST_COORDINATE ? wanted : LARGEST_COORDINATE;
        const double r00 = camera.row0[0], r01 = camera.row0[1], r02 = camera.row0[2];
        const double r10 = camera.row1[0], r11 = camera.row1[1], r12 = camera.row1[2];
        const double r20 = camera.row2[0], r21 = camera.row2[1], r22 = camera.row2[2];
        moved[0] = add(sample[0], mul(far, add(add(mul(r00, nx), mul(r01, ny)), mul(r02, nz))));
        moved[1] = add(sample[1], mul(far, add(add(mul(r10, nx), mul(r11, ny)), mul(r12, nz))));
        moved[2] = add(sample[2], mul(far, add(add(mul(r20, nx), mul(r21, ny)), mul(r22, nz))));
        return (s > 0.0f) & (det > mul(FLATTEST, mul(mxx, myy))) & (length >= NEAREST_MEASURED)
               & (length <= FARTHEST_MEASURED) & (absolute(moved[0]) <= LARGEST_COORDINATE)
               & (absolute(moved[1]) <= LARGEST_COORDINATE) & (absolute(moved[2]) <= LARGEST_COORDINATE);
    }
};
