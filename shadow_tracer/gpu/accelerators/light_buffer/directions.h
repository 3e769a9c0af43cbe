// needs: query exact/cube.h exact/light_space.h accelerators/light_buffer/on_cube.h
// arguments: Structure structure, LightSpace structure.space, Occluders asked.occluders
// constants: WILD_RATIO
// The cell of a ray's direction, and the list of its face; see light_buffer.py.
struct Walk1 {
    // Shows the triangles of a list that may be nearer to the light than a ray's depth; true if that was enough.
    static inline bool show(const Structure& structure, int list, float depth, int hint, Query1& query) {
        ++query.nodes;
        for (int k = structure.start.data[list]; k < structure.start.data[list + 1]; ++k) {
            if (structure.depths.data[k] < depth)
                return false;
            const int triangle = structure.members.data[k];
            if (triangle != hint && query.visit(triangle))
                return true;
        }
        return false;
    }
    static inline void walk(const Structure& structure, Query1& query) {
        const int columns = structure.columns.data[0];
        const float x = fabsf(query.u), y = fabsf(query.v), z = fabsf(query.w);
        const float size = x > y ? (x > z ? x : z) : (y > z ? y : z), sum = x + y + z + fabsf(query.z) + 1.0f;
        if (columns == 0 || !(sum <= WILD_RATIO * size && sum < 1.0e30f)) {
            query.everything();
            return;
        }
        OnCube1 at;
        at.look(query.u, query.v, query.w);
        const float depth = LightDepth1::of(query.z, 1.0f / at.size, structure.space.inverse != 0);
        const int cell =
            LightCells::number(at.face, LightCells::column(at.u, columns), LightCells::column(at.v, columns), columns);
        // The triangle that hid another ray of this cell last: whichever it is, it costs a test and no answer.
        int& last = structure.last.data[cell];
        const int hint = last;
        if (hint >= 0 && hint < query.triangle_count() && query.visit(hint))
            return;
        if (show(structure, cell, depth, hint, query)
            || show(structure, LightCells::of_face(at.face, columns), depth, hint, query))
            last = query.hider;
    }
};
