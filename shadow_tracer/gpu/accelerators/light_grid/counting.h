// cpu
// constants: FACES U_CELLS V_BITS V_CELLS
// arguments: Tiles tiles
// Sorting by (group, cell of u) and then, within columns, by the cell of v: of the rays of a pool, and of pieces.
struct Counting {
    static inline bool any(const Tiles& tiles, int number) { return tiles.fit.data[number][2] != 0.0f; }
    static inline void clear(const Tiles& tiles, const wp::array_t<int>& cells) {
        memset(cells.data, 0, FACES * tiles.lights * U_CELLS * sizeof(int));
    }
    // What lies in the order of (group, cell of u), within a cell in that it came in: so a column is a range. It comes
    // behind the first `count` elements of `keys` (then the cell of v) and `order`; cells: how many there are in each.
    static inline void gather(int count, const Tiles& tiles, const wp::array_t<int>& cells,
                              const wp::array_t<int>& keys, const wp::array_t<int>& order) {
        int sum = 0;
        for (int number = 0; number < FACES * tiles.lights; ++number) {
            int* cell = cells.data + U_CELLS * number;
            for (int k = 0; k < U_CELLS && any(tiles, number); ++k) {
                const int here = cell[k];
                cell[k] = sum;
                sum += here;
            }
            if (!any(tiles, number))
                cell[U_CELLS - 1] = sum;
        }
        for (int i = 0; i < count; ++i) {
            const int key = keys.data[i], to = count + cells.data[key >> V_BITS]++;
            keys.data[to] = key & (V_CELLS - 1);
            order.data[to] = order.data[i];
        }
    }
    // The n members of a column by their cells of v.
    static inline void sort(int n, const int* cell, const int* member, int* sorted) {
        int next[V_CELLS];
        for (int j = 0; j < V_CELLS; ++j)
            next[j] = 0;
        for (int i = 0; i < n; ++i)
            ++next[cell[i]];
        int sum = 0;
        for (int j = 0; j < V_CELLS; ++j) {
            const int here = next[j];
            next[j] = sum;
            sum += here;
        }
        for (int i = 0; i < n; ++i)
            sorted[next[cell[i]]++] = member[i];
    }
};
