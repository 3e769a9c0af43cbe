// needs: visibility/in_place.h accelerators/height_field/chart_ray.h
// arguments: Structure structure, DeviceChart wp::load(structure.charts.data)
// What becomes of a ray at a chart before its nodes are looked at.
struct AtChart {
    enum { PASSES, ENDS, ENTERS };
    // Where it enters, `ray` is the ray in the chart.
    static inline int come(const Structure& structure, int number, ChartRay& ray, Query1& query) {
        const auto& chart = structure.charts.data[number];
        const double beside = structure.beside.data[number];
        if (number == structure.sweep.number && query.passes())
            return PASSES;
        const int place = ray.place(chart, beside, query.sample(), query.light());
        if (place == ChartRay::TOO_FAR)
            return ChartRay::everything(chart, query) ? ENDS : PASSES;
        return place == ChartRay::MEETS ? ENTERS : PASSES;
    }
};
