// constants: LIT INVALID COUNTER_ROWS
struct SunStates {
    // States of the samples from `first` to `last` for a light that shines on all that are valid; counted: these are.
    static inline void some(int first, int last, int counted, int column, const wp::array_t<wp::uint8>& valid,
                            const wp::array_t<wp::uint8>& states, const wp::array_t<wp::int64>& counters) {
        int rays = 0;
        for (int i = first; i < last; ++i) {
            const bool good = valid.data[i] != 0;
            states.data[i] = good ? LIT : INVALID;
            rays += good;
        }
        if (rays && !counted)
            wp::atomic_add(counters.data + (size_t)(first / (last - first) & (COUNTER_ROWS - 1)) * counters.shape[1]
                               + column,
                           (wp::int64)rays);
    }
};
