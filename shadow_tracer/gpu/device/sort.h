// constants: SORT_DIGIT
// Warp's radix sort takes digits of 16 bits on the CPU, whose 65,536 counters and write positions do not fit the first
// cache; up to 12 bits do. A digit that all keys share is skipped.
struct Sort {
    // Stable, by the bits of keys from first_bit to last_bit; the next `count` elements of the arrays are scratch.
    static inline void pairs(int count, int first_bit, int last_bit, const wp::array_t<int>& keys,
                             const wp::array_t<int>& values) {
        int next[1 << SORT_DIGIT];
        int at = 0;
        // As few digits as there can be, of about the same size.
        const int passes = (last_bit - first_bit + SORT_DIGIT - 1) / SORT_DIGIT;
        const int digit = (last_bit - first_bit + passes - 1) / passes;
        for (int shift = first_bit; shift < last_bit; shift += digit) {
            const int mask = (1 << (last_bit - shift < digit ? last_bit - shift : digit)) - 1;
            const int* key = keys.data + (size_t)at * count;
            const int* value = values.data + (size_t)at * count;
            int* to_key = keys.data + (size_t)(1 - at) * count;
            int* to_value = values.data + (size_t)(1 - at) * count;
            for (int j = 0; j <= mask; ++j)
                next[j] = 0;
            for (int i = 0; i < count; ++i)
                ++next[key[i] >> shift & mask];
            if (count == 0 || next[key[0] >> shift & mask] == count)
                continue;
            int sum = 0;
            for (int j = 0; j <= mask; ++j) {
                const int here = next[j];
                next[j] = sum;
                sum += here;
            }
            for (int i = 0; i < count; ++i) {
                const int to = next[key[i] >> shift & mask]++;
                to_key[to] = key[i];
                to_value[to] = value[i];
            }
            at = 1 - at;
        }
        for (int i = 0; at == 1 && i < count; ++i) {
            keys.data[i] = keys.data[count + i];
            values.data[i] = values.data[count + i];
        }
    }
};
