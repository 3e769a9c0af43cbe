// needs: exact/record.h
// arguments: LightFrame frame
struct Corners {
    static inline void block(const LightFrame& frame, int first, int last, const wp::array_t<wp::vec3d>& vertices,
                             const wp::array_t<wp::vec4>& out) {
        const double* in = (const double*)vertices.data;
        float* to = (float*)out.data;
        const Axes1 axes = Axes1::of(frame);
        for (int i = first; i < last; ++i) {
            const Place1 at = axes.at(in[3 * (size_t)i], in[3 * (size_t)i + 1], in[3 * (size_t)i + 2]);
            to[4 * (size_t)i] = (float)at.u;
            to[4 * (size_t)i + 1] = (float)at.v;
            to[4 * (size_t)i + 2] = (float)at.w;
            to[4 * (size_t)i + 3] = (float)at.z;
        }
    }
};
