// needs: exact/arithmetic.h
// arguments: Pinhole camera
// A pixel's ray and its sample, in the optical frame.
struct Pixel : Arithmetic {
    // The point (x, y) of the ray at z = 1.
    static inline double across(const Pinhole& camera, const wp::array_t<wp::vec2>& table, int pixel, int column) {
        return camera.tabled ? (double)table.data[pixel][0] : (column - camera.cx) / camera.fx;
    }
    static inline double down(const Pinhole& camera, const wp::array_t<wp::vec2>& table, int pixel, int row) {
        return camera.tabled ? (double)table.data[pixel][1] : (row - camera.cy) / camera.fy;
    }
    // (x, y, z) of pixel i of the buffers with depth z, and the bias.
    static inline wp::vec4d sample(const Pinhole& camera, const wp::array_t<wp::vec2>& table, int i, double z) {
        const int pixel = camera.first + i, row = pixel / camera.width, column = pixel - row * camera.width;
        const double x = mul(across(camera, table, pixel, column), z), y = mul(down(camera, table, pixel, row), z);
        return wp::vec4d(x, y, z, add(camera.bias_constant, mul(camera.bias_quadratic, mul(z, z))));
    }
};
