// cpu
struct SamePoints {
    // Whether a coordinate or a mark of the points from `first` to `last` is not the one that is held. Without
    // branches, eight points at a time: it takes as long as reading them.
    static inline int differ(int first, int last, const wp::array_t<wp::vec3d>& points,
                             const wp::array_t<wp::uint8>& good, const wp::array_t<wp::vec4d>& held,
                             const wp::array_t<wp::uint8>& valid) {
        enum { LANES = 8 };
        typedef double Eight __attribute__((ext_vector_type(LANES), aligned(8)));
        typedef long Differs __attribute__((ext_vector_type(LANES)));
        const double *p = (const double*)(points.data + first), *q = (const double*)(held.data + first);
        const wp::uint8 *one = good.data + first, *other = valid.data + first;
        const int count = last - first;
        Differs differs = 0;
        int marks = 0, i = 0;
        for (; i + LANES <= count; i += LANES) {
            const Eight *theirs = (const Eight*)(p + 3 * i), *ours = (const Eight*)(q + 4 * i);
            const Eight a = ours[0], b = ours[1], c = ours[2], d = ours[3];
            differs |= theirs[0] != __builtin_shufflevector(a, b, 0, 1, 2, 4, 5, 6, 8, 9);
            differs |= theirs[1] != __builtin_shufflevector(b, c, 2, 4, 5, 6, 8, 9, 10, 12);
            differs |= theirs[2] != __builtin_shufflevector(c, d, 5, 6, 8, 9, 10, 12, 13, 14);
            for (int j = i; j < i + LANES; ++j)
                marks |= one[j] ^ other[j];
        }
        for (; i < count; ++i) {
            marks |= one[i] ^ other[i];
            for (int k = 0; k < 3; ++k)
                marks |= !(p[3 * i + k] == q[4 * i + k]);
        }
        for (int j = 0; j < LANES; ++j)
            marks |= differs[j] != 0;
        return marks != 0;
    }
};
