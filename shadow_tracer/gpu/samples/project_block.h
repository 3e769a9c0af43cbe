// cpu
// needs: samples/view.h
// constants: PROJECT_BLOCK
// arguments: LightFrame frame
struct ProjectBlock {
    static inline void block(int first, int count, const LightFrame& frame, int counted, int column,
                             const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid,
                             const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& states,
                             const wp::array_t<wp::int64>& counters) {
        typedef double Four[4];
        typedef float Ray[4];
        const int n = count - first < PROJECT_BLOCK ? count - first : PROJECT_BLOCK;
        const View view(frame);
        const Four* __restrict__ sample = (const Four*)(samples.data + first);
        const wp::uint8* __restrict__ good = valid.data + first;
        Ray* __restrict__ ray = (Ray*)(rays.data + first);
        wp::uint8 state[PROJECT_BLOCK]; // bytes may alias anything
        int traced = 0;
        for (int j = 0; j < n; ++j) {
            const Projected found = view.of(sample[j][0], sample[j][1], sample[j][2], sample[j][3], good[j] != 0);
            ray[j][0] = found.u;
            ray[j][1] = found.v;
            ray[j][2] = found.w;
            ray[j][3] = found.z;
            state[j] = (wp::uint8)found.state;
            traced += found.ray;
        }
        memcpy(states.data + first, state, n);
        if (counted == 0)
            wp::atomic_add(&counters.data[((first / PROJECT_BLOCK) & 63) * counters.shape[1] + column],
                           (wp::int64)traced);
    }
};
