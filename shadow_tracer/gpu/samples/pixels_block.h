// cpu
// needs: exact/arithmetic.h
// constants: UNPROJECT_BLOCK
// arguments: Pinhole camera, Depth depth
// The row and what depends on it alone is constant over a stretch of the image; where there is no measurement, z = 0
// keeps the arithmetic quiet and the sample unused.
struct UnprojectBlock : Arithmetic {
    static inline void block(int first, int count, const Pinhole& camera, const wp::array_t<wp::vec2>& table,
                             double units_per_metre, double largest, const Depth& depth,
                             const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid) {
        const bool tabled = camera.tabled;
        const double fx = camera.fx, cx = camera.cx, constant = camera.bias_constant, quadratic = camera.bias_quadratic;
        const double a0 = camera.row0[0], a1 = camera.row0[1], a2 = camera.row0[2], a3 = camera.row0[3];
        const double b0 = camera.row1[0], b1 = camera.row1[1], b2 = camera.row1[2], b3 = camera.row1[3];
        const double c0 = camera.row2[0], c1 = camera.row2[1], c2 = camera.row2[2], c3 = camera.row2[3];
        const int end = count - first < UNPROJECT_BLOCK ? count : first + UNPROJECT_BLOCK;
        typedef double Four[4];
        for (int i = first; i < end;) {
            const int pixel = camera.first + i, row = pixel / camera.width, column = pixel - row * camera.width;
            const int n = camera.width - column < end - i ? camera.width - column : end - i;
            const double level = (row - camera.cy) / camera.fy;
            const wp::vec2* __restrict__ ray = table.data + pixel;
            const auto* __restrict__ raw = depth.data + i;
            Four* __restrict__ sample = (Four*)(samples.data + i);
            wp::uint8* __restrict__ good = valid.data + i;
            for (int j = 0; j < n; ++j) {
                const double measured = raw[j];
                const bool is = measured > 0.0 && measured <= 1.7976931348623157e308;
                const double z = is ? measured / units_per_metre : 0.0;
                const double across = tabled ? (double)ray[j][0] : ((double)(column + j) - cx) / fx;
                const double down = tabled ? (double)ray[j][1] : level;
                const double x = mul(across, z), y = mul(down, z);
                const double px = add(add(add(mul(a0, x), mul(a1, y)), mul(a2, z)), a3);
                const double py = add(add(add(mul(b0, x), mul(b1, y)), mul(b2, z)), b3);
                const double pz = add(add(add(mul(c0, x), mul(c1, y)), mul(c2, z)), c3);
                const double bias = add(constant, mul(quadratic, mul(z, z)));
                sample[j][0] = px;
                sample[j][1] = py;
                sample[j][2] = pz;
                sample[j][3] = bias < largest ? bias : largest;
                good[j] = is & (absolute(px) <= largest) & (absolute(py) <= largest) & (absolute(pz) <= largest);
            }
            i += n;
        }
    }
};
