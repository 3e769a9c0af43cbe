// needs: query accelerators/segment.h accelerators/members.h
// arguments: Structure structure
// constants: GRID_DEPTHS
// From cell to cell of grids within cells; see hierarchical_grid.py.
struct Walk1 {
    // A cell of a grid, where the ray leaves it along each axis, and where it leaves the cell that holds the grid.
    struct Place {
        int grid, cell[3];
        float next[3], until;
    };

    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::MISSES)
            return;
        if (place == Segment::TOO_FAR) {
            query.everything();
            return;
        }
        float inverse[3];
        int turn[3];
        for (int k = 0; k < 3; ++k) {
            inverse[k] = 1.0f / segment.direction[k];
            turn[k] = segment.direction[k] > 0.0f ? 1 : -1;
        }
        Place at, above[GRID_DEPTHS - 1];
        int depth = 0;
        float now = 0.0f; // how far the ray has come
        // From the cell's number: a sum of steps would sum their roundings. No ray leaves a grid through its border,
        // which lies some roundings beside that of the cell that holds it: a ray along it would miss what is there.
        auto leave = [&](int k) {
            const auto& shape = structure.grids.data[at.grid].shape;
            const int side = at.cell[k] + (turn[k] > 0);
            if (side == 0 || side == shape.count[k])
                return 1.0e30f;
            return (shape.low[k] + (float)side * shape.size[k] - segment.origin[k]) * inverse[k];
        };
        auto enter = [&](int grid, float until) {
            at.grid = grid;
            at.until = until;
            const auto& shape = structure.grids.data[grid].shape;
            for (int k = 0; k < 3; ++k) {
                const float here = segment.origin[k] + now * segment.direction[k];
                const int cell = (int)((here - shape.low[k]) * shape.per_unit[k]), last = shape.count[k] - 1;
                at.cell[k] = cell < 0 ? 0 : cell > last ? last : cell;
                at.next[k] = leave(k);
            }
        };
        Mailboxes mailboxes;
        enter(0, segment.longest);
        for (;;) {
            ++query.nodes;
            const auto& grid = structure.grids.data[at.grid];
            const auto& count = grid.shape.count;
            const int number = grid.first + (at.cell[2] * count[1] + at.cell[1]) * count[0] + at.cell[0];
            int axis = at.next[0] < at.next[1] ? (at.next[0] < at.next[2] ? 0 : 2) : (at.next[1] < at.next[2] ? 1 : 2);
            const int inner = structure.inside.data[number];
            if (inner) {
                const float until = at.next[axis] < at.until ? at.next[axis] : at.until;
                above[depth++] = at;
                enter(inner, until);
                continue;
            }
            const int* start = structure.start.data + number;
            if (Members::show(structure.members, start[0], start[1], mailboxes, query))
                return;
            while (!(at.next[axis] <= at.until)) {
                if (!depth)
                    return;
                at = above[--depth];
                axis = at.next[0] < at.next[1] ? (at.next[0] < at.next[2] ? 0 : 2) : (at.next[1] < at.next[2] ? 1 : 2);
            }
            now = at.next[axis] > now ? at.next[axis] : now;
            at.cell[axis] += turn[axis];
            at.next[axis] = leave(axis);
        }
    }
};
