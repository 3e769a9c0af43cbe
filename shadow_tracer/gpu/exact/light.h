// needs: exact/arithmetic.h
struct LightSide : Arithmetic {
    // Unit vector to the light and the distance to it (the largest float64 for a light at infinity), the same bits as
    // the exact decision uses.
    static inline wp::vec4d towards(const wp::vec3d& p, const wp::vec4d& light) {
        double x = light[0], y = light[1], z = light[2];
        if (light[3] != 0.0) {
            x = sub(x, p[0]);
            y = sub(y, p[1]);
            z = sub(z, p[2]);
        }
        const double length = norm(x, y, z);
        const double scale = length > 0.0 ? 1.0 / length : 0.0;
        return wp::vec4d(mul(x, scale), mul(y, scale), mul(z, scale),
                         light[3] != 0.0 ? length : 1.7976931348623157e308);
    }
};
