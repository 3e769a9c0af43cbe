// cpu
// needs: device/lanes.h@16
// Sixteen rows of sixteen numbers become columns: halves change places, then quarters of them, and so on.
struct Transpose {
#define KEPT(d, j) ((j) & (d) ? 16 + (j) - (d) : (j))
#define TAKEN(d, j) ((j) & (d) ? 16 + (j) : (j) + (d))
#define EIGHT(which, d, j)                                                                                             \
    which(d, j), which(d, j + 1), which(d, j + 2), which(d, j + 3), which(d, j + 4), which(d, j + 5), which(d, j + 6), \
        which(d, j + 7)
#define SWAP(d)                                                                                                        \
    for (int k = 0; k < 16; ++k)                                                                                       \
        if (!(k & d)) {                                                                                                \
            const Real16 x = row[k], y = row[k + d];                                                                   \
            row[k] = __builtin_shufflevector(x, y, EIGHT(KEPT, d, 0), EIGHT(KEPT, d, 8));                              \
            row[k + d] = __builtin_shufflevector(x, y, EIGHT(TAKEN, d, 0), EIGHT(TAKEN, d, 8));                        \
        }
    static inline void rows(Real16 (&row)[16]) { SWAP(8) SWAP(4) SWAP(2) SWAP(1) }
#undef SWAP
#undef EIGHT
#undef TAKEN
#undef KEPT
};
