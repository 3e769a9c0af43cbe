// needs: exact/faces.h exact/planes.h
// arguments: LightSpace space, Occluders occluders
// The cells of directions that triangles lie in; see light_buffer.py.
struct LightCells {
    enum { FACES = 6 };
    // Column of a coordinate on a face: monotone, so what lies between two values lies between their columns.
    static inline int column(float u, int columns) {
        const float x = (u + 1.0f) * (0.5f * (float)columns), last = (float)(columns - 1);
        return (int)(x > 0.0f ? (x < last ? x : last) : 0.0f);
    }
    static inline int number(int face, int column, int row, int columns) {
        return (face * columns + row) * columns + column;
    }
    // The list of a face for triangles of which it is not known where on it they lie, or that cover most of it.
    static inline int of_face(int face, int columns) { return FACES * columns * columns + face; }
    // A triangle on a face: its columns and rows, and how near to the light it is; `all`: it is on the face's list.
    struct Place {
        int first_column, last_column, first_row, last_row;
        float nearest;
        bool none, all;

        inline Place(const Corners1& corners, int face, int columns, bool inverse) {
            Seen1 seen;
            seen.open();
            none = (seen.look(corners, face, inverse) & 1) != 0;
            all = !seen.bounded;
            nearest = all ? 3.0e38f : seen.nearest;
            first_column = column(seen.low_u, columns);
            last_column = column(seen.high_u, columns);
            first_row = column(seen.low_v, columns);
            last_row = column(seen.high_v, columns);
            all |= 2 * cells() > columns * columns;
        }
        inline int cells() const { return (last_column - first_column + 1) * (last_row - first_row + 1); }
    };
    // The corners of a triangle, and the faces that it touches: none if it casts nothing.
    static inline void look(const Occluders& occluders, const LightSpace& space, int triangle, Corners1& corners,
                            Corners1::Faces& touched) {
        Planes1 planes;
        planes.take((const float*)occluders.records.data + 16 * (size_t)triangle, 1, space);
        corners.gather(occluders.corners.data, occluders.triangles.data[triangle]);
        corners.touched(touched);
        for (int face = 0; face < FACES; ++face)
            touched[face] = planes.silent ? 0 : touched[face];
    }
    // In how many lists a triangle is.
    static inline wp::int64 count(const Occluders& occluders, const LightSpace& space, int triangle, int columns) {
        Corners1 corners;
        Corners1::Faces touched;
        look(occluders, space, triangle, corners, touched);
        wp::int64 found = 0;
        for (int face = 0; face < FACES; ++face) {
            if (!touched[face])
                continue;
            const Place at(corners, face, columns, space.inverse != 0);
            found += at.none ? 0 : at.all ? 1 : at.cells();
        }
        return found;
    }
    static inline void add(const wp::array_t<int>& begins, const wp::array_t<int>& members,
                           const wp::array_t<float>& depths, int list, int triangle, float depth) {
        const int at = wp::atomic_add(begins.data + list, 1);
        if (members.shape[0] > 0) {
            members.data[at] = triangle;
            depths.data[at] = depth;
        }
    }
    // Counts a triangle in its lists, or stores it there.
    static inline void enter(const Occluders& occluders, const LightSpace& space, int triangle, int columns,
                             const wp::array_t<int>& begins, const wp::array_t<int>& members,
                             const wp::array_t<float>& depths) {
        Corners1 corners;
        Corners1::Faces touched;
        look(occluders, space, triangle, corners, touched);
        for (int face = 0; face < FACES; ++face) {
            if (!touched[face])
                continue;
            const Place at(corners, face, columns, space.inverse != 0);
            if (at.none)
                continue;
            if (at.all) {
                add(begins, members, depths, of_face(face, columns), triangle, at.nearest);
                continue;
            }
            for (int row = at.first_row; row <= at.last_row; ++row)
                for (int column = at.first_column; column <= at.last_column; ++column)
                    add(begins, members, depths, number(face, column, row, columns), triangle, at.nearest);
        }
    }
};
