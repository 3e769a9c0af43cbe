// needs: exact/arithmetic.h
// ((r0 x + r1 y) + r2 z) + t per row, without contraction: the bits of Mesh.world_vertices and Camera.unproject.
struct Transform : Arithmetic {
    static inline void block(const wp::vec4d& row0, const wp::vec4d& row1, const wp::vec4d& row2, int first, int begin,
                             int end, const wp::array_t<wp::vec3d>& local, const wp::array_t<wp::vec3d>& world) {
        place((const double*)(local.data + begin), row0, row1, row2, end - begin,
              (double*)(world.data + first + begin));
    }
    // As `block`; number i of `world` is `order[i]` of `local`, from `first` on.
    static inline void ordered(const wp::vec4d& row0, const wp::vec4d& row1, const wp::vec4d& row2, int first, int end,
                               const wp::array_t<wp::vec3d>& local, const wp::array_t<int>& order,
                               const wp::array_t<wp::vec3d>& world) {
        enum { AT_ONCE = 64 };
        wp::vec3d some[AT_ONCE];
        for (int i = 0; i < end; i += AT_ONCE) {
            const int count = end - i < AT_ONCE ? end - i : AT_ONCE;
            for (int j = 0; j < count; ++j)
                some[j] = local.data[order.data[i + j]];
            place((const double*)some, row0, row1, row2, count, (double*)(world.data + first + i));
        }
    }
    static inline void place(const double* __restrict__ from, const wp::vec4d& row0, const wp::vec4d& row1,
                             const wp::vec4d& row2, int count, double* __restrict__ to) {
        for (int j = 0; j < count; ++j) {
            const double x = from[3 * j], y = from[3 * j + 1], z = from[3 * j + 2];
            to[3 * j] = add(add(add(mul(row0[0], x), mul(row0[1], y)), mul(row0[2], z)), row0[3]);
            to[3 * j + 1] = add(add(add(mul(row1[0], x), mul(row1[1], y)), mul(row1[2], z)), row1[3]);
            to[3 * j + 2] = add(add(add(mul(row2[0], x), mul(row2[1], y)), mul(row2[2], z)), row2[3]);
        }
    }
};
