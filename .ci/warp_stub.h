// As much of Warp's native library as the headers below shadow_tracer/gpu use, so that a linter can read them alone.
typedef decltype(sizeof(0)) size_t;
extern "C" {
float fabsf(float);
float floorf(float);
float ceilf(float);
double atan2(double, double);
double fabs(double);
double floor(double);
double ceil(double);
double sqrt(double);
float sqrtf(float);
void* memcpy(void*, const void*, size_t);
void* memset(void*, int, size_t);
}
#define HUGE_VAL (__builtin_huge_val())
namespace wp {
typedef int int32;
typedef unsigned int uint32;
typedef long long int64;
typedef unsigned long long uint64;
typedef unsigned char uint8;
typedef unsigned short uint16;
typedef float float32;
typedef double float64;
template <unsigned N, class T> struct vec_t {
    T c[N];
    vec_t() = default;
    explicit vec_t(T x);
    vec_t(T x, T y) : c { x, y } {}
    vec_t(T x, T y, T z) : c { x, y, z } {}
    vec_t(T x, T y, T z, T w) : c { x, y, z, w } {}
    T& operator[](int k) { return c[k]; }
    const T& operator[](int k) const { return c[k]; }
};
typedef vec_t<2, float> vec2;
typedef vec_t<3, float> vec3;
typedef vec_t<4, float> vec4;
typedef vec_t<3, double> vec3d;
typedef vec_t<4, double> vec4d;
typedef vec_t<2, int> vec2i;
typedef vec_t<3, int> vec3i;
typedef vec_t<4, int> vec4i;
template <class T> struct array_t {
    T* data;
    int shape[4];
};
template <class T> T atomic_add(T* to, T value);
template <class T> T atomic_and(T* to, T value);
template <class T> T atomic_or(T* to, T value);
template <class T> T atomic_max(T* to, T value);
template <class T> T atomic_min(T* to, T value);
template <class T> T min(T x, T y) { return x < y ? x : y; }
template <class T> T max(T x, T y) { return x > y ? x : y; }
bool isfinite(const vec3d& v);
vec3d operator+(const vec3d& x, const vec3d& y);
vec3d operator-(const vec3d& x, const vec3d& y);
vec3d operator*(double x, const vec3d& y);
vec3d cross(const vec3d& x, const vec3d& y);
vec3d normalize(const vec3d& x);
double length(const vec3d& x);
struct BVHPackedNodeHalf {
    float x, y, z;
    unsigned i : 31;
    unsigned b : 1;
};
struct BVH {
    BVHPackedNodeHalf *node_lowers, *node_uppers;
    int* primitive_indices;
    int* root;
    int num_nodes;
};
BVH bvh_get(uint64 id);
}
