// needs: query accelerators/members.h
// arguments: Structure structure
// constants: BSP_LEVELS BSP_TRIANGLE BSP_PAD
// Through the halves of space that hold something of the ray, that of the sample first; see bsp.py.
struct Walk1 {
    // A part of the ray: 0 is the sample, 1 the light.
    struct Part {
        double from, to;
    };
    // A plane's value along the ray: at the sample; at the light, or its slope if that is at infinity. And what either
    // may be off.
    struct Values {
        double sample, light, sample_off, light_off;
    };
    static inline double sum(double x, double y, double z) { return fabs(x) + fabs(y) + fabs(z); }
    static inline Values values(const Structure& structure, int number, const wp::vec2i& node, const wp::vec4d& p,
                                const wp::vec4d& l) {
        if (TreeNode::kind(node) != BSP_TRIANGLE) {
            const double c = structure.offsets.data[number];
            const int k = node[0];
            const double x = k == 0 ? p[0] : k == 1 ? p[1] : p[2], y = k == 0 ? l[0] : k == 1 ? l[1] : l[2];
            const double a = x - c, b = l[3] != 0.0 ? y - c : y;
            return { a, b, BSP_PAD * fabs(a), BSP_PAD * fabs(b) };
        }
        const wp::vec3i& corners = structure.triangles.data[node[0]];
        const wp::vec3d o = structure.vertices.data[corners[0]], r = structure.vertices.data[corners[1]],
                        s = structure.vertices.data[corners[2]];
        const double ax = r[0] - o[0], ay = r[1] - o[1], az = r[2] - o[2];
        const double bx = s[0] - o[0], by = s[1] - o[1], bz = s[2] - o[2];
        const double x = ay * bz - az * by, y = az * bx - ax * bz, z = ax * by - ay * bx;
        const double off = BSP_PAD * sum(ax, ay, az) * sum(bx, by, bz);
        const double px = p[0] - o[0], py = p[1] - o[1], pz = p[2] - o[2];
        const bool near = l[3] != 0.0;
        const double lx = near ? l[0] - o[0] : l[0], ly = near ? l[1] - o[1] : l[1], lz = near ? l[2] - o[2] : l[2];
        return { x * px + y * py + z * pz, x * lx + y * ly + z * lz, off * sum(px, py, pz), off * sum(lx, ly, lz) };
    }
    // Where something that is `a` at the sample, and `b` at the light or that steep, is not above 0.
    static inline Part below(const Part& within, double a, double b) {
        Part part = within;
        if (a > 0.0 && b >= 0.0) {
            part.to = -1.0;
        } else if (a > 0.0) {
            const double from = a / (a - b) * (1.0 - BSP_PAD);
            part.from = from > part.from ? from : part.from;
        } else if (b > 0.0) {
            const double to = a / (a - b) * (1.0 + BSP_PAD) + 1.0e-300;
            part.to = to < part.to ? to : part.to;
        }
        return part;
    }

    static inline void walk(const Structure& structure, Query1& query) {
        const wp::vec4d &p = query.sample(), &l = query.light();
        Mailboxes mailboxes;
        int waiting[BSP_LEVELS];
        Part parts[BSP_LEVELS];
        int top = 0, number = 0;
        Part part = { 0.0, 1.0 };
        for (;;) {
            ++query.nodes;
            const wp::vec2i node = structure.nodes.data[number];
            if (TreeNode::is_leaf(node)) {
                if (Members::show(structure.members, node, mailboxes, query) || top == 0)
                    return;
                number = waiting[--top];
                part = parts[top];
                continue;
            }
            const Values at = values(structure, number, node, p, l);
            const Part low = below(part, at.sample - at.sample_off, at.light - at.light_off);
            const Part high = below(part, -at.sample - at.sample_off, -at.light - at.light_off);
            const bool upwards = at.sample < 0.0;
            const Part &first = upwards ? low : high, &last = upwards ? high : low;
            const int child = (node[1] >> 2) + !upwards, other = (node[1] >> 2) + upwards;
            const bool in_first = first.from <= first.to, in_last = last.from <= last.to;
            if (in_first && in_last) {
                waiting[top] = other;
                parts[top++] = last;
            }
            number = in_first ? child : other;
            part = in_first ? first : last;
        }
    }
};
