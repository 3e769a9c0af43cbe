// needs: device/lanes.h
// lanes
// How far below zero a node's least value of a plane may be computed although a ray in it is inside, over the node's
// magnitude; light_space.py derives them.
struct WIDE(Pads) {
    // error: s_e of a record.
    static inline REAL edge(REAL error) { return 2.0f * error; }
    // slope, offset: s_N and s_D of a record.
    static inline REAL plane(REAL slope, REAL offset) { return 7.0f * (slope + offset); }
};
