// needs: query accelerators/segment.h accelerators/members.h
// arguments: Structure structure
// From cell to cell (Amanatides and Woo 1987); see uniform_grid.py.
struct Walk1 {
    static inline void walk(const Structure& structure, Query1& query) {
        Segment segment;
        const int place = segment.place(query, structure.box);
        if (place == Segment::MISSES)
            return;
        if (place == Segment::TOO_FAR) {
            query.everything();
            return;
        }
        const auto& shape = structure.shape.data[0];
        int cell[3], turn[3];
        float next[3], inverse[3];
        for (int k = 0; k < 3; ++k) {
            inverse[k] = 1.0f / segment.direction[k];
            turn[k] = segment.direction[k] > 0.0f ? 1 : -1;
            const int at = (int)((segment.origin[k] - shape.low[k]) * shape.per_unit[k]), last = shape.count[k] - 1;
            cell[k] = at < 0 ? 0 : at > last ? last : at;
        }
        // Where the ray leaves the cell along an axis. From the cell's number: a sum of steps would sum their
        // roundings.
        auto leave = [&](int k) {
            const float plane = shape.low[k] + (float)(cell[k] + (turn[k] > 0)) * shape.size[k];
            return (plane - segment.origin[k]) * inverse[k];
        };
        for (int k = 0; k < 3; ++k)
            next[k] = leave(k);
        Mailboxes mailboxes;
        for (;;) {
            ++query.nodes;
            const int number = (cell[2] * shape.count[1] + cell[1]) * shape.count[0] + cell[0];
            const int* start = structure.start.data + number;
            if (Members::show(structure.members, start[0], start[1], mailboxes, query))
                return;
            segment.shorten(query, structure.box);
            const int axis = next[0] < next[1] ? (next[0] < next[2] ? 0 : 2) : (next[1] < next[2] ? 1 : 2);
            if (!(next[axis] <= segment.longest))
                return;
            cell[axis] += turn[axis];
            if (cell[axis] < 0 || cell[axis] >= shape.count[axis])
                return;
            next[axis] = leave(axis);
        }
    }
};
