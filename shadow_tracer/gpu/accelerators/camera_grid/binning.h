// needs: accelerators/camera_grid/cover.h
// One triangle and one thread: how many tiles, and which.
struct Binning {
    static inline int count(int triangle, const Grid& grid, const wp::array_t<wp::vec3i>& triangles,
                            const wp::array_t<wp::vec4>& corners, const wp::array_t<wp::vec4>& records) {
        Cover cover(triangle, grid, triangles, corners, records);
        int found = 0;
        while (cover.next() != Cover::NONE)
            ++found;
        return found;
    }
    // `begin` is the number of its first entry, `first` that of the pass's.
    static inline void emit(int triangle, wp::int64 begin, wp::int64 first, const Grid& grid,
                            const wp::array_t<wp::vec3i>& triangles, const wp::array_t<wp::vec4>& corners,
                            const wp::array_t<wp::vec4>& records, const wp::array_t<wp::vec2i>& pairs,
                            const wp::array_t<int>& tiles) {
        Cover cover(triangle, grid, triangles, corners, records);
        const int capacity = pairs.shape[0];
        for (wp::int64 number = begin - first; number < capacity; ++number) {
            const int tile = cover.next();
            if (tile == Cover::NONE)
                return;
            if (number < 0)
                continue;
            pairs.data[number] = wp::vec2i(tile, triangle);
            wp::atomic_add(&tiles.data[tile], 1);
        }
    }
};
