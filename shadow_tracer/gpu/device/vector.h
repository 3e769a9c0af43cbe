// Four floats at a time, from where a multiple of sixteen bytes lies: Warp's vectors lie where any float may, so
// compilers for CUDA take them one by one.
struct Vector {
    static inline void load(const float* from, float* to) {
#if defined(__CUDA_ARCH__)
        const float4 four = *(const float4*)from;
        to[0] = four.x;
        to[1] = four.y;
        to[2] = four.z;
        to[3] = four.w;
#else
        memcpy(to, from, 16);
#endif
    }
};
