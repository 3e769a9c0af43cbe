// cpu
// needs: samples/pixels.h
// constants: UNPROJECT_BLOCK
// arguments: Pinhole camera, Depth depth
// The row and what depends on it alone is constant over a stretch of the image; where there is no measurement, z = 0
// keeps the arithmetic quiet and the sample unused.
struct UnprojectBlock {
    static inline void block(int first, int count, const Pinhole& camera, const wp::array_t<wp::vec2>& table,
                             double units_per_metre, double largest, const Depth& depth,
                             const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid) {
        const bool tabled = camera.tabled;
        const double fx = camera.fx, cx = camera.cx;
        const Pose pose(camera);
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
                const bool is = Pose::is_measured(measured);
                const double z = is ? measured / units_per_metre : 0.0;
                const double across = tabled ? (double)ray[j][0] : ((double)(column + j) - cx) / fx;
                const double down = tabled ? (double)ray[j][1] : level;
                good[j] = is & pose.sample(across, down, z, largest, sample[j]);
            }
            i += n;
        }
    }
};
