// needs: visibility/in_place.h accelerators/height_field/chart_ray.h accelerators/height_field/profile.h
// arguments: Structure structure, Sweep structure.sweep, DeviceChart wp::load(structure.charts.data)
// What becomes of a ray at a chart before its nodes are looked at.
struct AtChart {
    enum { PASSES, ENDS, ENTERS };
    // Where it enters, `ray` is the ray in the chart.
    static inline int come(const Structure& structure, int number, ChartRay& ray, Query1& query) {
        const auto& chart = structure.charts.data[number];
        const double beside = structure.beside.data[number];
        if (number == structure.sweep.number) {
            Profile profile(structure.sweep, structure.heights);
            const int found =
                profile.look(chart, beside, query.sample(), query.asked.vertices.data, structure.bounds.data);
            query.nodes += profile.strips;
            if (found == Profile::HIDDEN) {
                query.hide();
                return ENDS;
            }
            if (found == Profile::LIT)
                return PASSES;
        }
        const int place = ray.place(chart, beside, query.sample(), query.light());
        if (place == ChartRay::TOO_FAR)
            return ChartRay::everything(chart, query) ? ENDS : PASSES;
        return place == ChartRay::MEETS ? ENTERS : PASSES;
    }
};
