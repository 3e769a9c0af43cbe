// needs: exact/canonical.h exact/determinant.h
struct Decision : Determinant {
    // Bit 0: whether the triangle keeps the light from the sample; the other bits count the determinants that needed
    // expansion arithmetic.
    static inline int of(const wp::vec4d& sample, const wp::vec4d& light, const wp::vec3d& a, const wp::vec3d& b,
                         const wp::vec3d& c) {
        wp::vec3d v[3] = { a, b, c };
        Canonical::sort(v);

        const wp::vec3d p(sample[0], sample[1], sample[2]);
        const double bias = sample[3];
        // Question 0: on which side of the plane is the light; 1: is the sample on the other; 2 to 4: the planes
        // through the light and an edge. One call in a loop that stays a loop, or compilers inline the expansion
        // arithmetic five times.
        double value[5];
        // The bias compares values of the first two, which must not be roundings.
        const double least = bias > 0.0 ? 0x1p-20 : 1.0e-15;
        int light_side = 0, exact_used = 0;
#pragma unroll 1
        for (int question = 0; question < 5; ++question) {
            const int k = question - 2;
            const wp::vec4d from = question == 1 ? wp::vec4d(p[0], p[1], p[2], 1.0) : light;
            const wp::vec3d r = question < 2 ? v[1] : p;
            const wp::vec3d s = question < 2 ? v[2] : v[(k + 1) % 3];
            const wp::vec3d o = question < 2 ? v[0] : v[k];
            const int side = sign(from, r, s, o, value[question], exact_used, question < 2 ? least : 1.0e-15);
            if (question == 0)
                light_side = side;
            if (question == 0 ? side == 0 : question == 1 ? side * light_side >= 0 : side * light_side > 0)
                return exact_used << 1;
        }
        if (bias > 0.0) {
            // The biased start p + bias * (l - p) / |l - p| is still behind the plane iff A |l - p| > bias (D + A),
            // with A and D the distances of p and l from the plane; for a light at infinity iff A |s| > bias D.
            double x = light[0], y = light[1], z = light[2];
            const double behind = absolute(value[1]);
            double front = absolute(value[0]);
            if (light[3] != 0.0) {
                x = sub(x, p[0]);
                y = sub(y, p[1]);
                z = sub(z, p[2]);
                front = add(front, behind);
            }
            if (!(mul(behind, norm(x, y, z)) > mul(bias, front)))
                return exact_used << 1;
        }
        return (exact_used << 1) | 1;
    }
};
