// needs: accelerators/fits.h
// constants: ABSENT IN_TREE WILD LIT ADMIT_BLOCK
// Which rays go into a structure over light space; see admission.py.
struct Admission {
    // Without branches.
    static inline int group(const wp::vec4& ray, wp::uint8 state) {
        const int fits = Fits1::of(ray[0], ray[1], ray[2], ray[3]);
        const int takes_part = (state == LIT) & (ray[0] == ray[0]);
        return takes_part ? WILD - fits * (WILD - IN_TREE) : ABSENT;
    }
    static inline void list(int ray, const wp::array_t<int>& wild, const wp::array_t<int>& counts) {
        wild.data[wp::atomic_add(counts.data + 1, 1)] = ray;
    }
    static inline void one(int ray, const wp::array_t<wp::vec4>& rays, const wp::array_t<wp::uint8>& states,
                           const wp::array_t<wp::uint8>& groups, const wp::array_t<int>& wild,
                           const wp::array_t<int>& counts) {
        const int found = group(rays.data[ray], states.data[ray]);
        groups.data[ray] = (wp::uint8)found;
        if (found == WILD)
            list(ray, wild, counts);
    }
    // Those of a block; the first loop is for vector registers.
    static inline void block(int first, int count, const wp::array_t<wp::vec4>& rays,
                             const wp::array_t<wp::uint8>& states, const wp::array_t<wp::uint8>& groups,
                             const wp::array_t<int>& wild, const wp::array_t<int>& counts) {
        wp::uint8 kind[ADMIT_BLOCK];
        const int n = count - first < ADMIT_BLOCK ? count - first : ADMIT_BLOCK;
        const wp::vec4* ray = rays.data + first;
        const wp::uint8* state = states.data + first;
        int wilds = 0;
        for (int j = 0; j < n; ++j) {
            kind[j] = (wp::uint8)group(ray[j], state[j]);
            wilds += kind[j] == WILD;
        }
        memcpy(groups.data + first, kind, n);
        for (int j = 0; wilds > 0; ++j)
            if (kind[j] == WILD) {
                list(first + j, wild, counts);
                --wilds;
            }
    }
};
