// needs: samples/view.h
// arguments: LightFrame frame
struct Project {
    // Ray and state of sample i; returns whether its ray is one to be counted.
    static inline int one(int i, const LightFrame& frame, const wp::array_t<wp::vec4d>& samples,
                          const wp::array_t<wp::uint8>& valid, const wp::array_t<wp::vec4>& rays,
                          const wp::array_t<wp::uint8>& states) {
        const wp::vec4d sample = samples.data[i];
        const Projected found = View(frame).of(sample[0], sample[1], sample[2], sample[3], valid.data[i] != 0);
        rays.data[i] = wp::vec4(found.u, found.v, found.w, found.z);
        states.data[i] = (wp::uint8)found.state;
        return found.ray;
    }
};
