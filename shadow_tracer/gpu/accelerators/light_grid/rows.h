// cpu
// constants: LEAST_ROW MOST_ROW
// Points that come row by row, as those of an image or a grid do.
struct Rows {
    enum { ASKED = 32, NEAR = 6, FAR = 16, LOOSE = -1 };
    static inline double apart(const wp::vec4d& p, const wp::vec4d& q) {
        return fabs(p[0] - q[0]) + fabs(p[1] - q[1]) + fabs(p[2] - q[2]);
    }
    // How many points a row seems to have, 0 if they come in no rows: of some points, the one that many places behind
    // is about as near as the next one.
    static inline int find(int count, const wp::array_t<wp::vec4d>& samples) {
        const int longest = count / 4 < MOST_ROW ? count / 4 : MOST_ROW;
        float sum[MOST_ROW + 1]; // of distances, in steps from a point to the next
        for (int row = LEAST_ROW; row <= longest; ++row)
            sum[row] = 0.0f;
        int loose = 0;
        for (int k = 0; k < ASKED; ++k) {
            const wp::vec4d* at = samples.data + (size_t)((double)(count - longest - 1) * k / ASKED);
            const float step = (float)apart(at[0], at[1]), inverse = step > 0.0f ? 1.0f / step : 0.0f, far = FAR;
            const size_t other = (size_t)((double)(count - 1) * ((k + ASKED / 2) % ASKED) / ASKED);
            loose += !(FAR * (double)step < apart(at[0], samples.data[other]));
            for (int row = LEAST_ROW; row <= longest; ++row) {
                const float steps = (float)apart(at[0], at[row]) * inverse;
                sum[row] += steps < far ? steps : far; // NaN counts as far
            }
        }
        if (loose > ASKED / 2)
            return LOOSE;
        int best = LEAST_ROW;
        for (int row = LEAST_ROW; row <= longest; ++row)
            best = sum[row] < sum[best] ? row : best;
        return longest >= LEAST_ROW && sum[best] <= (float)(NEAR * ASKED) ? best : 0;
    }
};
