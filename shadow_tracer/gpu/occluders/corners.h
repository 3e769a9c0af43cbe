// arguments: LightFrame frame
// project_vertices for a block; plain loops over the 3 (or 4) numbers of each vertex, which the CPU's compiler
// vectorises.
struct Corners {
    static inline void block(const LightFrame& frame, int first, int last, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec4>& out) {
        const double* in = (const double*)vertices.data;
        float* to = (float*)out.data;
        const double k = frame.inverse_scale, w0 = frame.w_constant, w1 = frame.w_slope;
        const double cx = frame.center[0], cy = frame.center[1], cz = frame.center[2];
        const double rx = frame.r[0], ry = frame.r[1], rz = frame.r[2];
        const double sx = frame.s[0], sy = frame.s[1], sz = frame.s[2];
        const double fx = frame.f[0], fy = frame.f[1], fz = frame.f[2];
        for (int i = first; i < last; ++i) {
            const double x = (in[3 * (size_t)i] - cx) * k, y = (in[3 * (size_t)i + 1] - cy) * k;
            const double z = (in[3 * (size_t)i + 2] - cz) * k;
            const double depth = fx * x + fy * y + fz * z;
            to[4 * (size_t)i] = (float)(rx * x + ry * y + rz * z);
            to[4 * (size_t)i + 1] = (float)(sx * x + sy * y + sz * z);
            to[4 * (size_t)i + 2] = (float)(w0 - w1 * depth);
            to[4 * (size_t)i + 3] = (float)depth;
        }
    }
};
