// cpu
// needs: device/lanes.h@16
// constants: TREE_LANES BLOCK_FLOOR
// Sixteen triangles against a ray, or a bundle of them: those that may be met; bvh.py derives the bands.
struct Block {
    static inline Real16 row(const float* rows, int k) { return *(const Real16*)(rows + TREE_LANES * k); }
    static inline Real16 smaller(Real16 x, Real16 y) { return __builtin_elementwise_min(x, y); }
    static inline Real16 larger(Real16 x, Real16 y) { return __builtin_elementwise_max(x, y); }
    // As bits.
    static inline int possible(const float* rows, const wp::vec3& origin, const wp::vec3& direction, float band,
                               float longest) {
        const Real16 cx = row(rows, 0) - origin[0], cy = row(rows, 1) - origin[1], cz = row(rows, 2) - origin[2];
        const Real16 ax = row(rows, 3), ay = row(rows, 4), az = row(rows, 5);
        const Real16 bx = row(rows, 6), by = row(rows, 7), bz = row(rows, 8);
        const float dx = direction[0], dy = direction[1], dz = direction[2];
        const Real16 rx = cy * dz - cz * dy, ry = cz * dx - cx * dz, rz = cx * dy - cy * dx;
        const Real16 u = rx * bx + ry * by + rz * bz, v = -(rx * ax + ry * ay + rz * az);
        const Real16 nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        const Real16 along = nx * dx + ny * dy + nz * dz, off = nx * cx + ny * cy + nz * cz;
        const Real16 w = along - u - v, size = row(rows, 9), most = size * band;
        const Real16 low = smaller(smaller(u, v), w), high = larger(larger(u, v), w);
        const Real16 end = along * longest, none = 0.0f, aside = size * most + (float)BLOCK_FLOOR;
        const Mask16 inside = (low >= -most) | (high <= most);
        const Mask16 within = (off >= smaller(end, none) - aside) & (off <= larger(end, none) + aside);
        return Lanes16::bits(inside & within);
    }
};
