// needs: exact/arithmetic.h
// constants: LIT OUTSIDE
struct LightSide : Arithmetic {
    // State of a sample before any triangle is looked at. Without contraction, so that the border of the cone has the
    // same bits everywhere.
    static inline int reaches(const wp::vec3d& p, const wp::vec4d& light, const wp::vec3d& axis, double cosine,
                              double reach) {
        if (light[3] == 0.0)
            return LIT;
        const double x = sub(p[0], light[0]), y = sub(p[1], light[1]), z = sub(p[2], light[2]);
        const double distance = norm(x, y, z);
        if (distance > reach)
            return OUTSIDE;
        const double along = add(add(mul(x, axis[0]), mul(y, axis[1])), mul(z, axis[2]));
        return along < mul(cosine, distance) ? OUTSIDE : LIT;
    }
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
