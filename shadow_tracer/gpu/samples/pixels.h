// needs: exact/arithmetic.h
// arguments: Pinhole camera
// A pixel's ray, in the optical frame.
struct Pixel : Arithmetic {
    // The point (x, y) of the ray at z = 1.
    static inline double across(const Pinhole& camera, const wp::array_t<wp::vec2>& table, int pixel, int column) {
        return camera.tabled ? (double)table.data[pixel][0] : (column - camera.cx) / camera.fx;
    }
    static inline double down(const Pinhole& camera, const wp::array_t<wp::vec2>& table, int pixel, int row) {
        return camera.tabled ? (double)table.data[pixel][1] : (row - camera.cy) / camera.fy;
    }
};
// What makes a sample of a pixel's ray and depth: the camera's pose and the bias.
struct Pose : Arithmetic {
    double a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, constant, quadratic;

    inline explicit Pose(const Pinhole& camera) {
        a0 = camera.row0[0], a1 = camera.row0[1], a2 = camera.row0[2], a3 = camera.row0[3];
        b0 = camera.row1[0], b1 = camera.row1[1], b2 = camera.row1[2], b3 = camera.row1[3];
        c0 = camera.row2[0], c1 = camera.row2[1], c2 = camera.row2[2], c3 = camera.row2[3];
        constant = camera.bias_constant, quadratic = camera.bias_quadratic;
    }
    static inline bool is_measured(double raw) { return raw > 0.0 && raw <= 1.7976931348623157e308; }
    // The sample (x, y, z, bias) in the world; returns whether it is no farther than coordinates may be.
    inline int sample(double across, double down, double z, double largest, double* to) const {
        const double x = mul(across, z), y = mul(down, z);
        const double px = add(add(add(mul(a0, x), mul(a1, y)), mul(a2, z)), a3);
        const double py = add(add(add(mul(b0, x), mul(b1, y)), mul(b2, z)), b3);
        const double pz = add(add(add(mul(c0, x), mul(c1, y)), mul(c2, z)), c3);
        const double bias = add(constant, mul(quadratic, mul(z, z)));
        to[0] = px;
        to[1] = py;
        to[2] = pz;
        to[3] = bias < largest ? bias : largest;
        return (absolute(px) <= largest) & (absolute(py) <= largest) & (absolute(pz) <= largest);
    }
};
