// needs: exact/filter.h device/vector.h
// The float32 filter for a thread with one ray.
struct FilterOne {
    // 0 no, 1 yes, 2 maybe.
    static inline int answer(const float* record, const wp::vec4& ray, float magnitude) {
        int yes = 0;
        float numbers[16];
        for (int k = 0; k < 16; k += 4)
            Vector::load(record + k, numbers + k);
        return Filter1::possible(numbers, ray[0], ray[1], ray[2], ray[3], magnitude, yes) ? 2 - yes : 0;
    }
};
