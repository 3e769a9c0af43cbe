// cpu
// needs: exact/sixteen.h
// constants: RECORDS_BLOCK
// arguments: LightFrame frame
// The records of a block of triangles, sixteen at a time.
struct Records {
    static inline void block(int first, int count, const LightFrame& frame, double factor, double slope_factor,
                             double offset_factor, double u32, double setup, double largest_offset,
                             const wp::array_t<wp::vec3d>& vertices, const wp::array_t<wp::vec3i>& triangles,
                             int first_record, const wp::array_t<wp::vec4>& records, int cull, int row,
                             const wp::array_t<wp::vec2i>& silent) {
        const int end = count - first < RECORDS_BLOCK ? count : first + RECORDS_BLOCK;
        const Axes8 axes = Axes8::of(frame);
        const Factors8 factors = { factor, slope_factor, offset_factor, u32, setup, largest_offset };
        int degenerate = 0, culled = 0;
        for (int sixteen = first; sixteen < end; sixteen += 16) {
            const int n = end - sixteen < 16 ? end - sixteen : 16;
            float* to = (float*)(records.data + 4 * (size_t)(first_record + sixteen - first));
            Sixteen it;
            it.gather(sixteen, count, vertices, triangles);
            it.project(axes);
            int nothing, off;
            it.find_sides(frame.light, cull, sixteen, triangles, nothing, off);
            degenerate += nothing;
            culled += off;
            Real16 made[16];
            it.planes(axes, factors, made);
            Transpose::rows(made);
            for (int j = 0; j < n; ++j)
                memcpy(to + 16 * j, &made[j], 64);
        }
        silent.data[row] = wp::vec2i(degenerate, culled);
    }
};
