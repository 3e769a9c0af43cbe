// cpu
// needs: accelerators/camera_grid/cover.h
// A pass of one thread: triangles into tiles until the pairs are full or the triangles at an end, then the lists, in
// order.
struct InOrder {
    // Of the cursor: the triangle to go on with, how many of its entries are done, entries of this pass.
    enum { TRIANGLE, DONE, ENTRIES };
    // Triangles from here to the one whose corners are fetched.
    enum { AHEAD = 8 };

    static inline void bin(int count, const Grid& grid, const wp::array_t<wp::vec3i>& triangles,
                           const wp::array_t<wp::vec4>& corners, const wp::array_t<wp::vec4>& records,
                           const wp::array_t<wp::vec2i>& pairs, const wp::array_t<int>& tiles,
                           const wp::array_t<int>& lists, const wp::array_t<int>& cursor) {
        const int capacity = pairs.shape[0], tile_count = tiles.shape[0];
        int n = 0, triangle = cursor.data[TRIANGLE], done = cursor.data[DONE];
        for (int k = 0; k < tile_count; ++k)
            tiles.data[k] = 0;
        for (; triangle < count; ++triangle) {
            if (triangle + AHEAD < count)
                __builtin_prefetch(corners.data + triangles.data[triangle + AHEAD][0]);
            Cover cover(triangle, grid, triangles, corners, records);
            int number = 0, tile;
            while ((tile = cover.next()) != Cover::NONE) {
                if (number >= done) {
                    if (n == capacity)
                        break;
                    pairs.data[n++] = wp::vec2i(tile, triangle);
                    ++tiles.data[tile];
                }
                ++number;
            }
            done = 0;
            if (tile != Cover::NONE) {
                done = number;
                break;
            }
        }
        int end = 0;
        for (int k = 0; k < tile_count; ++k)
            tiles.data[k] = end += tiles.data[k];
        for (int k = n - 1; k >= 0; --k)
            lists.data[--tiles.data[pairs.data[k][0]]] = pairs.data[k][1];
        cursor.data[TRIANGLE] = triangle;
        cursor.data[DONE] = done;
        cursor.data[ENTRIES] = n;
    }
};
