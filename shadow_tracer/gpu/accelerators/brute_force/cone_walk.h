// needs: accelerators/half_lines.h
// arguments: ConeScene scene
// No structure: every triangle.
struct ConeWalk : HalfLines {
    const ConeScene& scene;
    double after, wanted; // not looked at
    int spent;            // triangles shown
    int budget;           // goes on to `spent`

    inline ConeWalk(const ConeScene& scene, const Cone& cone, double slope, double lean, bool)
        : HalfLines(scene.tree.box, cone, slope, lean), scene(scene), after(0.0), wanted(HUGE_VAL), spent(0),
          budget(1 << 30) {}
    inline void narrow() { narrowed = true; }
    inline int next() { return spent < scene.count && spent <= budget ? spent++ : -1; }
};
