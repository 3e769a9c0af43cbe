// arguments: LightFrame frame
// A light's frame over samples, from where they are: what make_light_frame makes (light_frame.py).
struct FrameOver {
    // Sets all of `frame` but what is said of the light.
    static inline void complete(LightFrame& frame, const wp::vec3d& center, double scale) {
        const wp::vec4d& light = frame.light;
        wp::vec3d f(light[0], light[1], light[2]);
        frame.w_constant = 1.0, frame.w_slope = 0.0;
        if (light[3] != 0.0) {
            f = f - center;
            const double distance = wp::length(f), reference = distance > scale ? distance : scale;
            frame.w_constant = distance / reference, frame.w_slope = scale / reference;
            if (!(distance > 0.0))
                f = wp::vec3d(0.0, 0.0, 1.0);
        }
        f = wp::normalize(wp::normalize(f));
        // The axis least aligned with f gives a well-conditioned orthonormal basis.
        const double x = fabs(f[0]), y = fabs(f[1]), z = fabs(f[2]);
        const wp::vec3d axis = x <= y && x <= z ? wp::vec3d(1.0, 0.0, 0.0)
                               : y <= z         ? wp::vec3d(0.0, 1.0, 0.0)
                                                : wp::vec3d(0.0, 0.0, 1.0);
        frame.r = wp::normalize(wp::cross(axis, f));
        frame.s = wp::cross(f, frame.r);
        frame.f = f;
        frame.center = center;
        frame.inverse_scale = 1.0 / scale;
    }
};
