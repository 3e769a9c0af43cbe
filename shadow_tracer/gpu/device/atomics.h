// cpu
// Work that several threads need and one of them does: 0 not begun, 1 begun, 2 done.
struct Claims {
    // Whether the item is for the caller to make; then publish it.
    static inline int claim(const wp::array_t<int>& made, int item) {
        int none = 0;
        return __atomic_compare_exchange_n(made.data + item, &none, 1, false, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED);
    }
    static inline void publish(const wp::array_t<int>& made, int item) {
        __atomic_store_n(made.data + item, 2, __ATOMIC_RELEASE);
    }
    // Whoever has claimed an item is making it at this moment: some microseconds.
    static inline void await(const wp::array_t<int>& made, int item) {
        while (__atomic_load_n(made.data + item, __ATOMIC_ACQUIRE) != 2) {
        }
    }
};
