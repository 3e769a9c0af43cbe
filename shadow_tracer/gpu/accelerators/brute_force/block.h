// cpu
// needs: exact/filter.h@16
// constants: LIT SHADOWED PENDING BRUTE_FORCE_BLOCK
// Up to 256 rays against all triangles. Rays lie sixteen together, and stay in the first cache; one that is done makes
// room for the last.
struct BruteForce {
    enum { GROUPS = BRUTE_FORCE_BLOCK / 16 };
    float rays[GROUPS][5][16]; // U V W Z magnitude
    int index[BRUTE_FORCE_BLOCK], queued[BRUTE_FORCE_BLOCK], already[BRUTE_FORCE_BLOCK];
    int n;

    inline void take(int j, const wp::vec4& ray, float floor) {
        float* to = &rays[j / 16][0][j % 16];
        for (int k = 0; k < 4; ++k)
            to[16 * k] = ray[k];
        to[64] = fabsf(ray[0]) + fabsf(ray[1]) + fabsf(ray[3]) + floor;
    }
    inline void replace(int j) {
        --n;
        for (int k = 0; k < 5; ++k)
            rays[j / 16][k][j % 16] = rays[n / 16][k][n % 16];
        index[j] = index[n];
        already[j] = already[n];
        queued[j] = queued[n];
    }
    inline void choose(int first, int count, int attempt, float floor, const wp::array_t<wp::vec4>& from,
                       const wp::array_t<int>& resume, const wp::array_t<wp::uint8>& states) {
        n = 0;
        for (int i = first; i < first + BRUTE_FORCE_BLOCK && i < count; ++i) {
            const wp::vec4& ray = from.data[i];
            if (ray[0] != ray[0] || states.data[i] != (attempt > 0 ? PENDING : LIT))
                continue;
            take(n, ray, floor);
            index[n] = i;
            already[n] = attempt == 2 ? resume.data[i] : 0;
            queued[n] = 0;
            states.data[i] = LIT;
            ++n;
        }
        // Lanes behind the last hold something that can be computed with.
        for (int j = n; j % 16; ++j)
            take(j, wp::vec4(0.0f, 0.0f, 0.0f, 0.0f), floor);
    }
    static inline void block(int first, int count, int attempt, int triangle_count, float floor, int leaf_tests,
                             const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::vec4>& records,
                             const wp::array_t<wp::vec2i>& queue, const wp::array_t<int>& queue_count,
                             const wp::array_t<int>& resume, const wp::array_t<wp::uint8>& states,
                             const wp::array_t<wp::int64>& counters) {
        BruteForce it;
        it.choose(first, count, attempt, floor, rays, resume, states);
        const float* record = (const float*)records.data;
        wp::int64 tests = 0;
        for (int t = 0; t < triangle_count && it.n > 0; ++t, record += 16) {
            tests += it.n;
            // From the last to the first, so that whoever takes the place of another has been looked at.
            for (int group = (it.n - 1) / 16; group >= 0; --group) {
                int yes = 0;
                int possible = Filter16::possible(record, it.rays[group][0], yes);
                if (16 * group + 16 > it.n)
                    possible &= (1 << (it.n - 16 * group)) - 1;
                while (possible) {
                    const int lane = 31 - __builtin_clz(possible), j = 16 * group + lane;
                    possible ^= 1 << lane;
                    int state = SHADOWED;
                    if (!(yes >> lane & 1)) {
                        if (it.queued[j]++ < it.already[j])
                            continue;
                        const int slot = wp::atomic_add(&queue_count.data[0], 1);
                        if (slot < queue.shape[0]) {
                            queue.data[slot] = wp::vec2i(it.index[j], t);
                            continue;
                        }
                        state = PENDING;
                        resume.data[it.index[j]] = it.queued[j] - 1;
                    }
                    states.data[it.index[j]] = state;
                    it.replace(j);
                }
            }
        }
        const int row = first / BRUTE_FORCE_BLOCK & 63;
        wp::atomic_add(&counters.data[row * counters.shape[1] + leaf_tests], tests);
    }
};
