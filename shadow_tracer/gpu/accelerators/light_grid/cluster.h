// cpu
// needs: exact/sixteen.h exact/planes.h@16 accelerators/light_grid/side.h@16
// constants: FILTER_FACTOR SLOPE_FACTOR OFFSET_FACTOR U32 SETUP_ERROR LARGEST_OFFSET
// arguments: LightFrame frame, LightSpace space, Casters casters
// The sixteen triangles of a cluster as a light sees them: their corners at once, their planes when they are known to
// touch a tile. Nothing of it outlives the cluster but the records, while entries of them wait.
struct Cluster {
    Sixteen sixteen;
    const Casters& casters;
    const LightFrame& frame;
    const LightSpace& space;
    const Axes8 axes;
    Front16 front;
    Planes16 planes;
    int first; // triangle

    inline Cluster(const Casters& casters, const LightFrame& frame, const LightSpace& space)
        : casters(casters), frame(frame), space(space), axes(Axes8::of(frame)) {}
    inline void fetch(int number) const {
        Sixteen::fetch(16 * number, casters.count, casters.vertices, casters.triangles);
    }
    // aligned: whether its rays are in the aligned frustum.
    inline void open(int number, bool aligned) {
        first = 16 * number;
        sixteen.gather(first, casters.count, casters.vertices, casters.triangles);
        sixteen.project(axes);
        sixteen.corners(front.corners.at);
        front.corners.measure();
        front.open(sixteen.some, aligned);
    }
    // Their planes; records: where sixteen of them go. What casts nothing is noted for the light at `place`.
    inline void take(int place, float* records) {
        int degenerate, culled;
        sixteen.find_sides(frame.light, casters.cull, first, casters.triangles, degenerate, culled);
        if (degenerate + culled) {
            wp::uint8* to = casters.silent.data + 2 * (place * casters.silent_apart + first / 16);
            to[0] = (wp::uint8)degenerate;
            to[1] = (wp::uint8)culled;
        }
        const Factors8 factors = { FILTER_FACTOR, SLOPE_FACTOR, OFFSET_FACTOR, U32, SETUP_ERROR, LARGEST_OFFSET };
        Real16 rows[16];
        sixteen.planes(axes, factors, rows);
        planes.load(rows, space);
        Transpose::rows(rows);
        for (int j = 0; j < 16; ++j)
            Lanes16::store(records + 16 * j, rows[j]);
    }
};
