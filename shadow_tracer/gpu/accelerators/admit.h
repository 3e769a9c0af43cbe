// constants: ADMIT_BLOCK LIT PENDING WILD WILD_RATIO
// admit_all for a block of up to ADMIT_BLOCK samples; the first loop is for vector registers.
struct Admit {
    static inline void block(int first, int count, const wp::array_t<wp::vec4>& rays,
                             const wp::array_t<wp::uint8>& states, const wp::array_t<int>& resume,
                             const wp::array_t<wp::uint8>& group, const wp::array_t<int>& wild,
                             const wp::array_t<int>& counts) {
        wp::uint8 kind[ADMIT_BLOCK];
        const int n = count - first < ADMIT_BLOCK ? count - first : ADMIT_BLOCK;
        const wp::vec4* ray = rays.data + first;
        const wp::uint8* state = states.data + first;
        int wilds = 0;
        for (int j = 0; j < n; ++j) {
            const float x = fabsf(ray[j][0]), y = fabsf(ray[j][1]), z = fabsf(ray[j][2]);
            float size = x > y ? x : y;
            size = size > z ? size : z;
            const float sum = x + y + z + fabsf(ray[j][3]) + 1.0f;
            const int fits = (sum <= WILD_RATIO * size) & (sum < 1.0e30f);
            const int takes_part = ((state[j] == LIT) | (state[j] == PENDING)) & (ray[j][0] == ray[j][0]);
            kind[j] = (wp::uint8)(takes_part * (WILD - fits));
            wilds += takes_part & (1 - fits);
        }
        for (int j = 0; j < n; ++j) {
            group.data[first + j] = kind[j];
            resume.data[first + j] = 0;
        }
        for (int j = 0; wilds > 0; ++j)
            if (kind[j] == WILD) {
                wild.data[counts.data[1]++] = first + j;
                --wilds;
            }
    }
};
