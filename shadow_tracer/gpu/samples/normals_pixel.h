// needs: samples/normals.h samples/pixels.h
// arguments: Pinhole camera, Depth depth
// One pixel and one thread.
struct Displace : Normal {
    static inline wp::vec4d sample(int i, const Pinhole& camera, const wp::array_t<wp::vec2>& table, const Depth& depth,
                                   const wp::vec4d& sample) {
        const int pixel = camera.first + i, row = pixel / camera.width, column = pixel - row * camera.width;
        const float s = inverse((float)depth.data[pixel]);
        float w = 0.0f, x = 0.0f, y = 0.0f, xx = 0.0f, xy = 0.0f, yy = 0.0f, d = 0.0f, xd = 0.0f, yd = 0.0f;
#pragma unroll 1
        for (int k = 0; k < 9; ++k) {
            const int v = k / 3 - 1, u = k % 3 - 1;
            const int at_row = row + v * camera.step_down, at_column = column + u * camera.step_across;
            if (at_row < 0 || at_row >= camera.height || at_column < 0 || at_column >= camera.width)
                continue;
            const int at = at_row * camera.width + at_column;
            const float other = inverse((float)depth.data[at]), e = minus(other, s);
            if (!counts(other, e, s))
                continue;
            float px = times((float)u, camera.across), py = times((float)v, camera.down);
            if (camera.tabled) {
                px = minus(table.data[at][0], table.data[pixel][0]);
                py = minus(table.data[at][1], table.data[pixel][1]);
                if (px != px || py != py)
                    continue; // one of them has no ray
            }
            w = plus(w, 1.0f);
            x = plus(x, px);
            y = plus(y, py);
            xx = plus(xx, times(px, px));
            xy = plus(xy, times(px, py));
            yy = plus(yy, times(py, py));
            d = plus(d, e);
            xd = plus(xd, times(px, e));
            yd = plus(yd, times(py, e));
        }
        const double from[4] = { sample[0], sample[1], sample[2], sample[3] };
        double moved[3];
        const double across = Pixel::across(camera, table, pixel, column);
        const double down = Pixel::down(camera, table, pixel, row);
        const bool good = move(camera, from, s, across, down, w, x, y, xx, xy, yy, d, xd, yd, moved);
        return good ? wp::vec4d(moved[0], moved[1], moved[2], sample[3]) : sample;
    }
};
