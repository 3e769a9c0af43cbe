// needs: samples/view.h
// constants: LIT INVALID COUNTER_ROWS PROJECT_BLOCK
// arguments: LightFrame frame
// States before any triangle, of samples whose rays nobody looks at.
struct States {
    // Returns how many of the samples from `first` on have a ray to a light at infinity, which shines on all that are
    // valid.
    static inline int sun(int first, int count, const wp::array_t<wp::uint8>& valid, wp::uint8* state) {
        int rays = 0;
        for (int j = 0; j < count; ++j) {
            const bool good = valid.data[first + j] != 0;
            state[j] = good ? LIT : INVALID;
            rays += good;
        }
        return rays;
    }
    static inline int lamp(int first, int count, const LightFrame& frame, const wp::array_t<wp::vec4d>& samples,
                           const wp::array_t<wp::uint8>& valid, wp::uint8* state) {
        typedef double Four[4];
        const View view(frame);
        const Four* __restrict__ sample = (const Four*)(samples.data + first);
        const wp::uint8* __restrict__ good = valid.data + first;
        int rays = 0;
        for (int j = 0; j < count; ++j) { // what of a ray is not looked at here is not computed
            const Projected found = view.of(sample[j][0], sample[j][1], sample[j][2], sample[j][3], good[j] != 0);
            state[j] = (wp::uint8)found.state;
            rays += found.ray;
        }
        return rays;
    }
    // Those from `first` to `last`; counted: their rays have been.
    static inline void some(int first, int last, const LightFrame& frame, int counted, int column,
                            const wp::array_t<wp::vec4d>& samples, const wp::array_t<wp::uint8>& valid,
                            const wp::array_t<wp::uint8>& states, const wp::array_t<wp::int64>& counters) {
#if defined(__CUDA_ARCH__)
        enum { BLOCK = 1 };
#else
        enum { BLOCK = PROJECT_BLOCK };
#endif
        wp::uint8 state[BLOCK]; // bytes may alias anything
        int rays = 0;
        for (int i = first; i < last; i += BLOCK) {
            const int count = last - i < BLOCK ? last - i : BLOCK;
            rays += frame.light[3] == 0.0 ? sun(i, count, valid, state) : lamp(i, count, frame, samples, valid, state);
            memcpy(states.data + i, state, count);
        }
        if (rays && !counted)
            wp::atomic_add(counters.data + (size_t)(first / (last - first) & (COUNTER_ROWS - 1)) * counters.shape[1]
                               + column,
                           (wp::int64)rays);
    }
};
