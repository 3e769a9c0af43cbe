// constants: FIT_CELLS COLUMN_LOOKUP
// Cells across the rays of a face.
struct Fit {
    // Tiles.fit of rays between these values.
    static inline wp::vec4 of(float low_u, float low_v, float high_u, float high_v) {
        if (low_u > high_u)
            return wp::vec4(0.0f, 0.0f, 0.0f, 0.0f);
        const float wide = high_u - low_u, high = high_v - low_v, cells = FIT_CELLS;
        return wp::vec4(low_u, low_v, cells / (wide > 1.0e-12f ? wide : 1.0e-12f),
                        cells / (high > 1.0e-12f ? high : 1.0e-12f));
    }
    // Cell of u in Tiles.lookup: monotone, so what lies between two values lies between their cells.
    static inline int cell(float u, const wp::vec4& fit) {
        const float x = (u - fit[0]) * fit[2] * ((float)COLUMN_LOOKUP / (float)FIT_CELLS), last = COLUMN_LOOKUP - 1;
        return (int)(x > 0.0f ? (x < last ? x : last) : 0.0f);
    }
};
