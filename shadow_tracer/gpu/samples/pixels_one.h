// needs: samples/pixels.h
// arguments: Pinhole camera, Depth depth
// One pixel and one thread.
struct Unproject {
    static inline void one(int i, const Pinhole& camera, const wp::array_t<wp::vec2>& table, double units_per_metre,
                           double largest, const Depth& depth, const wp::array_t<wp::vec4d>& samples,
                           const wp::array_t<wp::uint8>& valid) {
        valid.data[i] = 0;
        const double raw = depth.data[i];
        if (!Pose::is_measured(raw))
            return;
        const int pixel = camera.first + i, row = pixel / camera.width, column = pixel - row * camera.width;
        const double across = Pixel::across(camera, table, pixel, column);
        const double down = Pixel::down(camera, table, pixel, row);
        valid.data[i] = Pose(camera).sample(across, down, raw / units_per_metre, largest, (double*)(samples.data + i));
    }
};
