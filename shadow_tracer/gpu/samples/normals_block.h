// cpu
// needs: samples/normals.h
// constants: NORMALS_BLOCK
// arguments: Pinhole camera, Depth depth
// Sums of a stretch of a row, one neighbour after the other, for vector registers; a neighbour outside of the image
// adds nothing.
struct DisplaceBlock : Normal {
    float s[NORMALS_BLOCK], w[NORMALS_BLOCK], x[NORMALS_BLOCK], y[NORMALS_BLOCK], xx[NORMALS_BLOCK];
    float xy[NORMALS_BLOCK], yy[NORMALS_BLOCK], d[NORMALS_BLOCK], xd[NORMALS_BLOCK], yd[NORMALS_BLOCK];

    inline void add_up(int j, bool is, float px, float py, float pxx, float pxy, float pyy, float e) {
        w[j] = plus(w[j], is ? 1.0f : 0.0f);
        x[j] = plus(x[j], is ? px : 0.0f);
        y[j] = plus(y[j], is ? py : 0.0f);
        xx[j] = plus(xx[j], is ? pxx : 0.0f);
        xy[j] = plus(xy[j], is ? pxy : 0.0f);
        yy[j] = plus(yy[j], is ? pyy : 0.0f);
        d[j] = plus(d[j], is ? e : 0.0f);
        xd[j] = plus(xd[j], is ? times(px, e) : 0.0f);
        yd[j] = plus(yd[j], is ? times(py, e) : 0.0f);
    }
    // The sums of n pixels from `pixel` on, all in a row.
    inline void sum(const Pinhole& camera, const wp::array_t<wp::vec2>& table, const Depth& depth, int pixel, int n) {
        const int row = pixel / camera.width, column = pixel - row * camera.width;
        const wp::vec2* own_ray = table.data + pixel;
        for (int j = 0; j < n; ++j) {
            s[j] = inverse((float)depth.data[pixel + j]);
            w[j] = x[j] = y[j] = xx[j] = xy[j] = yy[j] = d[j] = xd[j] = yd[j] = 0.0f;
        }
        for (int k = 0; k < 9; ++k) {
            const int v = k / 3 - 1, u = k % 3 - 1;
            const int at_row = row + v * camera.step_down, shift = column + u * camera.step_across;
            if (at_row < 0 || at_row >= camera.height)
                continue;
            const int begin = shift < 0 ? -shift : 0, stop = camera.width - shift < n ? camera.width - shift : n;
            const int line = at_row * camera.width + shift;
            if (camera.tabled) {
                for (int j = begin; j < stop; ++j) {
                    const float other = inverse((float)depth.data[line + j]), e = minus(other, s[j]);
                    const float px = minus(table.data[line + j][0], own_ray[j][0]);
                    const float py = minus(table.data[line + j][1], own_ray[j][1]);
                    // NaN: one of them has no ray.
                    const bool is = counts(other, e, s[j]) & (px == px) & (py == py);
                    add_up(j, is, px, py, times(px, px), times(px, py), times(py, py), e);
                }
                continue;
            }
            const float px = times((float)u, camera.across), py = times((float)v, camera.down);
            const float pxx = times(px, px), pxy = times(px, py), pyy = times(py, py);
            for (int j = begin; j < stop; ++j) {
                const float other = inverse((float)depth.data[line + j]), e = minus(other, s[j]);
                add_up(j, counts(other, e, s[j]), px, py, pxx, pxy, pyy, e);
            }
        }
    }
    static inline void block(int first, int count, const Pinhole& camera, const wp::array_t<wp::vec2>& table,
                             const Depth& depth, const wp::array_t<wp::vec4d>& samples) {
        DisplaceBlock it;
        const int end = count - first < NORMALS_BLOCK ? count - first : NORMALS_BLOCK;
        typedef double Four[4];
        for (int i = 0; i < end;) {
            const int pixel = camera.first + first + i, row = pixel / camera.width, column = pixel - row * camera.width;
            const int n = camera.width - column < end - i ? camera.width - column : end - i;
            it.sum(camera, table, depth, pixel, n);
            const double fx = camera.fx, cx = camera.cx, level = (row - camera.cy) / camera.fy;
            const wp::vec2* ray = table.data + pixel;
            Four* __restrict__ place = (Four*)(samples.data + first + i);
            for (int j = 0; j < n; ++j) {
                const double across = camera.tabled ? (double)ray[j][0] : ((double)(column + j) - cx) / fx;
                const double down = camera.tabled ? (double)ray[j][1] : level;
                double moved[3];
                const bool good = move(camera, place[j], it.s[j], across, down, it.w[j], it.x[j], it.y[j], it.xx[j],
                                       it.xy[j], it.yy[j], it.d[j], it.xd[j], it.yd[j], moved);
                for (int k = 0; k < 3; ++k)
                    place[j][k] = good ? moved[k] : place[j][k];
            }
            i += n;
        }
    }
};
