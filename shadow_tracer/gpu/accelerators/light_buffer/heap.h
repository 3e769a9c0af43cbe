// Sorts a list in place, by one thread (Williams 1964: heapsort).
struct HeapSort {
    // Whether one is to come after the other: farther from the light, or the same and a larger number.
    static inline bool after(const int* members, const float* depths, int i, int j) {
        return depths[i] < depths[j] || (depths[i] == depths[j] && members[i] > members[j]);
    }
    static inline void swap(int* members, float* depths, int i, int j) {
        const int member = members[i];
        const float depth = depths[i];
        members[i] = members[j], depths[i] = depths[j];
        members[j] = member, depths[j] = depth;
    }
    // Lets an element sink in the heap of the first `count`, whose top comes last.
    static inline void sink(int* members, float* depths, int i, int count) {
        for (int child = 2 * i + 1; child < count; child = 2 * i + 1) {
            if (child + 1 < count && after(members, depths, child + 1, child))
                ++child;
            if (!after(members, depths, child, i))
                return;
            swap(members, depths, i, child);
            i = child;
        }
    }
    static inline void descending(int first, int last, const wp::array_t<int>& members,
                                  const wp::array_t<float>& depths) {
        int* member = members.data + first;
        float* depth = depths.data + first;
        const int count = last - first;
        for (int i = count / 2 - 1; i >= 0; --i)
            sink(member, depth, i, count);
        for (int end = count - 1; end > 0; --end) {
            swap(member, depth, 0, end);
            sink(member, depth, 0, end);
        }
    }
};
