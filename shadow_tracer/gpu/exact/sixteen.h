// cpu
// needs: device/transpose.h exact/determinant.h exact/record.h@8
// constants: GAP_VERTEX
// arguments: LightFrame frame
// Sixteen triangles that follow each other, in two halves of eight: their corners, the side of each that the light is
// on, and their planes, each when it is asked for. The side is decided as Determinant::sign does it, without
// contraction; what float64 leaves open gets the exact sign one by one (no permanent is above 1e-15 of NaN, so corners
// that are not finite are left open, too). The filter's bound covers any contraction of the rest.
struct Sixteen {
    enum { ALL = 0xFFFF };
    int some; // the lanes that hold a triangle, as bits; those behind the last repeat it
    Double8 corner[2][3][3];
    Place8 at[2][3];
    Double8 side[2]; // 1 or -1; of those that cast nothing 0

    typedef double Two __attribute__((ext_vector_type(2), aligned(8)));
    typedef double Four __attribute__((ext_vector_type(4)));
    // x, or y, of eight corners.
    static inline Double8 eight(const Two (&low)[8], int second) {
#define PAIR(j)                                                                                                        \
    (second ? __builtin_shufflevector(low[j], low[j + 1], 1, 3) : __builtin_shufflevector(low[j], low[j + 1], 0, 2))
        const Four a = __builtin_shufflevector(PAIR(0), PAIR(2), 0, 1, 2, 3);
        const Four b = __builtin_shufflevector(PAIR(4), PAIR(6), 0, 1, 2, 3);
#undef PAIR
        return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
    }
    // The triangles from `first` on, of `count` in all. x and y of a corner are one register, and registers are put
    // together: gathering eight numbers by their places takes several times as long on some processors.
    inline void gather(int first, int count, const wp::array_t<wp::vec3d>& vertices,
                       const wp::array_t<wp::vec3i>& triangles) {
        const int n = count - first < 16 ? count - first : 16;
        some = ALL >> (16 - n);
        for (int half = 0; half < 2; ++half)
            for (int k = 0; k < 3; ++k) {
                Two low[8];
                double z[8];
                for (int j = 0; j < 8; ++j) {
                    const int lane = 8 * half + j;
                    const wp::vec3d& from = vertices.data[triangles.data[first + (lane < n ? lane : n - 1)][k]];
                    low[j] = *(const Two*)&from;
                    z[j] = from[2];
                }
                corner[half][k][0] = eight(low, 0);
                corner[half][k][1] = eight(low, 1);
                const Double8 last = { z[0], z[1], z[2], z[3], z[4], z[5], z[6], z[7] };
                corner[half][k][2] = last;
            }
    }
    // Brings their corners into the cache.
    static inline void fetch(int first, int count, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec3i>& triangles) {
        const int end = first + 16 < count ? first + 16 : count;
        for (int t = first; t < end; ++t)
            for (int k = 0; k < 3; ++k)
                __builtin_prefetch(vertices.data + triangles.data[t][k]);
    }
    inline void project(const Axes8& axes) {
        for (int half = 0; half < 2; ++half)
            for (int k = 0; k < 3; ++k)
                at[half][k] = axes.at(corner[half][k][0], corner[half][k][1], corner[half][k][2]);
    }
    static inline Real16 rounded(Double8 low, Double8 high) {
        const Real8 a = __builtin_convertvector(low, Real8), b = __builtin_convertvector(high, Real8);
        return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    }
    // U V W Z of each corner, each within 2^-24 relative and 2^-46 (1 + its distance from the anchor) of exact.
    inline void corners(Real16 (&to)[3][4]) const {
        for (int k = 0; k < 3; ++k) {
            to[k][0] = rounded(at[0][k].u, at[1][k].u);
            to[k][1] = rounded(at[0][k].v, at[1][k].v);
            to[k][2] = rounded(at[0][k].w, at[1][k].w);
            to[k][3] = rounded(at[0][k].z, at[1][k].z);
        }
    }
    static inline int bits(decltype(Double8() < Double8()) x) {
        return Lanes8::bits(__builtin_convertvector(x, Mask8));
    }
    // Sets the sides of a half; returns the lanes that are left open, as bits.
    inline int judge(int half, const wp::vec4d& light) {
        UNCONTRACTED
        const Double8(&a)[3] = corner[half][0];
        const Double8(&b)[3] = corner[half][1];
        const Double8(&c)[3] = corner[half][2];
        const Double8 none = 0.0, one = 1.0;
        const Double8 qx = light[0] - light[3] * a[0], qy = light[1] - light[3] * a[1], qz = light[2] - light[3] * a[2];
        const Double8 rx = b[0] - a[0], ry = b[1] - a[1], rz = b[2] - a[2];
        const Double8 sx = c[0] - a[0], sy = c[1] - a[1], sz = c[2] - a[2];
        const Double8 x0 = ry * sz, x1 = rz * sy, y0 = rz * sx, y1 = rx * sz, z0 = rx * sy, z1 = ry * sx;
        const Double8 value = qx * (x0 - x1) + qy * (y0 - y1) + qz * (z0 - z1);
        const Double8 permanent = Lanes8::absolute(qx) * (Lanes8::absolute(x0) + Lanes8::absolute(x1))
                                  + Lanes8::absolute(qy) * (Lanes8::absolute(y0) + Lanes8::absolute(y1))
                                  + Lanes8::absolute(qz) * (Lanes8::absolute(z0) + Lanes8::absolute(z1));
        const auto sure = Lanes8::absolute(value) > 1.0e-15 * permanent;
        side[half] = sure ? (value > none ? one : -one) : none;
        return ~bits(sure | (permanent == none)) & Lanes8::ALL;
    }
    inline wp::vec3d corner_of(int half, int k, int j) const {
        return wp::vec3d(corner[half][k][0][j], corner[half][k][1][j], corner[half][k][2][j]);
    }
    // Sets `side`, and counts the triangles that cast nothing: those that are degenerate, and those culled. With `cull`
    // triangles whose front faces the light cast nothing.
    inline void find_sides(const wp::vec4d& light, int cull, int first, const wp::array_t<wp::vec3i>& triangles,
                           int& degenerate, int& culled) {
        int nothing = 0, front = 0;
        for (int half = 0; half < 2; ++half) {
            for (int open = judge(half, light); open; open &= open - 1) {
                const int j = __builtin_ctz(open);
                const wp::vec3d a = corner_of(half, 0, j), b = corner_of(half, 1, j), c = corner_of(half, 2, j);
                double value;
                int exact_used = 0;
                if (wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c))
                    side[half][j] = Determinant::sign(light, b, c, a, value, exact_used);
            }
            nothing |= bits(side[half] == 0.0) << 8 * half;
            if (cull) {
                const Double8 none = 0.0;
                const auto off = side[half] > 0.0;
                front |= bits(off) << 8 * half;
                side[half] = off ? none : side[half];
            }
        }
        degenerate = culled = 0;
        for (nothing &= some; nothing; nothing &= nothing - 1)
            degenerate += triangles.data[first + __builtin_ctz(nothing)][0] != GAP_VERTEX;
        culled = __builtin_popcount(front & some);
    }
    // The numbers of their records, each of all sixteen; those that cast nothing get one that says no to every ray.
    inline void planes(const Axes8& axes, const Factors8& factors, Real16 (&row)[16]) const {
        Double8 low[16], high[16];
        Record8::of(axes, factors, corner[0], at[0], side[0]).list(low);
        Record8::of(axes, factors, corner[1], at[1], side[1]).list(high);
        for (int k = 0; k < 16; ++k)
            row[k] = rounded(low[k], high[k]);
        const int never = bits(side[0] == 0.0) | bits(side[1] == 0.0) << 8;
        if (never) {
            const Mask16 which = Lanes16::mask(never);
            for (int k = 0; k < 16; ++k) {
                const Real16 value = k == 15 ? 1.0f : 0.0f; // g = 0 - 1 < -0
                row[k] = which ? value : row[k];
            }
        }
    }
};
