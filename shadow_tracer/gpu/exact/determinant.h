// needs: exact/arithmetic.h
// Unevaluated sums of float64: components that do not overlap, the smallest first (Shewchuk 1997). compress() packs
// them, so n components cover at least (n - 2) * 53 bits; the domain of determinant.py spans fewer than 1600 bits.
struct Expansion : Arithmetic {
    enum { MOST = 64 };
    double h[MOST];
    int n;

    // s + e == x + y exactly
    static inline void two_sum(double x, double y, double& s, double& e) {
        s = add(x, y);
        const double t = sub(s, x);
        e = add(sub(x, sub(s, t)), sub(y, t));
    }
    // p + e == x * y exactly
    static inline void two_product(double x, double y, double& p, double& e) {
        p = mul(x, y);
#if defined(__CUDA_ARCH__)
        e = __fma_rn(x, y, -p);
#else
        double c = mul(134217729.0, x);
        const double xh = sub(c, sub(c, x));
        const double xl = sub(x, xh);
        c = mul(134217729.0, y);
        const double yh = sub(c, sub(c, y));
        const double yl = sub(y, yh);
        e = sub(mul(xl, yl), sub(sub(sub(p, mul(xh, yh)), mul(xl, yh)), mul(xh, yl)));
#endif
    }
    inline void compress() {
        double top = h[n - 1];
        int bottom = n - 1;
        for (int i = n - 2; i >= 0; --i) {
            double sum, error;
            two_sum(top, h[i], sum, error);
            if (error != 0.0) {
                h[bottom--] = sum;
                top = error;
            } else {
                top = sum;
            }
        }
        h[bottom] = top;
        int count = 0;
        double carry = h[bottom];
        for (int i = bottom + 1; i < n; ++i) {
            double sum, error;
            two_sum(h[i], carry, sum, error);
            if (error != 0.0)
                h[count++] = error;
            carry = sum;
        }
        h[count++] = carry;
        n = count;
    }
    inline void grow(double x) {
        if (n == MOST)
            compress();
        int kept = 0;
        for (int i = 0; i < n; ++i) {
            double sum, error;
            two_sum(x, h[i], sum, error);
            if (error != 0.0)
                h[kept++] = error;
            x = sum;
        }
        if (x != 0.0 && kept < MOST)
            h[kept++] = x;
        n = kept;
    }
};
struct Determinant : Arithmetic {
    // Sign of det[q - w*o, r - o, s - o]; value is its float64 approximation, exact_used counts what float64 alone
    // could not tell. Where the value is to be right as well, to a relative 9e-16 / least, `least` is above 1e-15.
    static inline int sign(const wp::vec4d& q, const wp::vec3d& r, const wp::vec3d& s, const wp::vec3d& o,
                           double& value, int& exact_used, double least = 1.0e-15) {
        double m[3][3];
        for (int k = 0; k < 3; ++k) {
            m[0][k] = q[3] != 0.0 ? sub(q[k], o[k]) : q[k];
            m[1][k] = sub(r[k], o[k]);
            m[2][k] = sub(s[k], o[k]);
        }
        double permanent = 0.0;
        value = 0.0;
        for (int k = 0; k < 3; ++k) {
            const int i = (k + 1) % 3, j = (k + 2) % 3;
            const double ij = mul(m[1][i], m[2][j]), ji = mul(m[1][j], m[2][i]);
            value = add(value, mul(m[0][k], sub(ij, ji)));
            permanent = add(permanent, mul(absolute(m[0][k]), add(absolute(ij), absolute(ji))));
        }
        // 8 roundings per term (3 differences, 2 products, 1 subtraction, 2 additions) are 8.9e-16 of the permanent.
        if (absolute(value) > mul(least, permanent))
            return value > 0.0 ? 1 : -1;
        if (permanent == 0.0)
            return 0;
        exact_used += 1;
        return exactly(q, r, s, o, m, value);
    }
    // Few pairs come here: not inlined, so that the others need fewer registers.
    static __attribute__((noinline)) int exactly(const wp::vec4d& q, const wp::vec3d& r, const wp::vec3d& s,
                                                 const wp::vec3d& o, const double (&m)[3][3], double& value) {
        double tail[3][3];
        for (int k = 0; k < 3; ++k) {
            const double origin = o[k];
            const double from[3] = { q[k], r[k], s[k] };
            for (int row = 0; row < 3; ++row) {
                double unused;
                if (row == 0 && q[3] == 0.0)
                    tail[row][k] = 0.0;
                else
                    Expansion::two_sum(from[row], -origin, unused, tail[row][k]);
            }
        }
        Expansion sum;
        sum.n = 0;
#pragma unroll 1
        for (int term = 0; term < 6; ++term) {
            const int first = term / 2;
            const int i = (first + 1 + term % 2) % 3, j = (first + 2 - term % 2) % 3;
#pragma unroll 1
            for (int part = 0; part < 8; ++part) {
                double x = part & 1 ? tail[0][first] : m[0][first];
                const double y = part & 2 ? tail[1][i] : m[1][i];
                const double z = part & 4 ? tail[2][j] : m[2][j];
                if (x == 0.0 || y == 0.0 || z == 0.0)
                    continue;
                if (term % 2)
                    x = -x;
                double high, low, p, e;
                Expansion::two_product(x, y, high, low);
#pragma unroll 1
                for (int half = 0; half < 4; ++half) {
                    Expansion::two_product(half < 2 ? high : low, z, p, e);
                    sum.grow(half % 2 ? p : e);
                }
            }
        }
        value = 0.0;
        for (int i = 0; i < sum.n; ++i)
            value = add(value, sum.h[i]);
        if (sum.n == 0)
            return 0;
        return sum.h[sum.n - 1] > 0.0 ? 1 : -1;
    }
};
