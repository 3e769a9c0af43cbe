// needs: exact/determinant.h
// constants: GAP_VERTEX
// Triangles that cast nothing for a light: those that it sees edge-on, that have no area or a corner that is not a
// number, and those whose front faces it, if these are culled; not those of gaps. As records count them
// (exact/records.h).
struct SilentTriangles {
    static inline void count(int first, int last, const wp::vec4d& light, int cull,
                             const wp::array_t<wp::vec3d>& vertices, const wp::array_t<wp::vec3i>& triangles, int row,
                             const wp::array_t<wp::vec2i>& counts) {
        int degenerate = 0, culled = 0;
        for (int t = first; t < last; ++t) {
            const wp::vec3i& corner = triangles.data[t];
            const wp::vec3d &a = vertices.data[corner[0]], &b = vertices.data[corner[1]], &c = vertices.data[corner[2]];
            double value;
            int used = 0, side = 0;
            if (wp::isfinite(a) && wp::isfinite(b) && wp::isfinite(c))
                side = Determinant::sign(light, b, c, a, value, used);
            degenerate += side == 0 && corner[0] != GAP_VERTEX;
            culled += cull != 0 && side > 0;
        }
        wp::vec2i& to = counts.data[row];
        if (degenerate)
            wp::atomic_add(&to[0], degenerate);
        if (culled)
            wp::atomic_add(&to[1], culled);
    }
};
