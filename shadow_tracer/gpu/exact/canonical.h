// Corners in an order that depends on nothing but where they are: what is rounded on the way from them is the same for
// every order and winding.
struct Canonical {
    static inline bool before(const wp::vec3d& x, const wp::vec3d& y) {
        return x[0] != y[0] ? x[0] < y[0] : x[1] != y[1] ? x[1] < y[1] : x[2] < y[2];
    }
    static inline void order(wp::vec3d& x, wp::vec3d& y) {
        if (before(y, x)) {
            const wp::vec3d t = x;
            x = y;
            y = t;
        }
    }
    static inline void sort(wp::vec3d (&corners)[3]) {
        order(corners[0], corners[1]);
        order(corners[1], corners[2]);
        order(corners[0], corners[1]);
    }
};
