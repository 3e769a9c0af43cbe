// constants: TREE_LANES CONE_ROUGH
// Sixteen triangles of a block beside a cone, in float32, on the CPU: which may meet it, and which may hide all of it;
// cones.py derives the pads.
#if !defined(__CUDA_ARCH__)
struct ConeBlock {
    typedef float Reals __attribute__((ext_vector_type(16), aligned(4)));
    typedef int Masks __attribute__((ext_vector_type(16)));
    typedef bool Bits __attribute__((ext_vector_type(16)));
    struct Vector {
        Reals x, y, z;
        inline Vector operator+(const Vector& o) const { return { x + o.x, y + o.y, z + o.z }; }
        inline Vector operator-(const Vector& o) const { return { x - o.x, y - o.y, z - o.z }; }
        inline Reals dot(const Vector& o) const { return x * o.x + y * o.y + z * o.z; }
        inline Vector cross(const Vector& o) const {
            return { y * o.z - z * o.y, z * o.x - x * o.z, x * o.y - y * o.x };
        }
        inline Vector absolutes() const { return { absolute(x), absolute(y), absolute(z) }; }
        inline Vector cross_sum(const Vector& o) const {
            return { y * o.z + z * o.y, z * o.x + x * o.z, x * o.y + y * o.x };
        }
        inline Reals sum() const { return absolute(x) + absolute(y) + absolute(z); }
    };
    Vector apex, way;       // in units of the scene's extent; a unit along the axis
    Reals slope, end, band; // end: of the axis, or beyond

    static inline Reals absolute(Reals x) { return __builtin_elementwise_abs(x); }
    static inline Reals least(Reals x, Reals y) { return __builtin_elementwise_min(x, y); }
    static inline Reals most(Reals x, Reals y) { return __builtin_elementwise_max(x, y); }
    static inline int bits(Masks x) { return __builtin_bit_cast(unsigned short, __builtin_convertvector(x, Bits)); }
    static inline Vector rows(const float* from) {
        return { *(const Reals*)from, *(const Reals*)(from + TREE_LANES), *(const Reals*)(from + 2 * TREE_LANES) };
    }
    inline void begin(const double* origin, const double* axis, double tangent, double longest) {
        apex = { (Reals)(float)origin[0], (Reals)(float)origin[1], (Reals)(float)origin[2] };
        way = { (Reals)(float)axis[0], (Reals)(float)axis[1], (Reals)(float)axis[2] };
        slope = (float)tangent;
        end = (float)(longest * 1.00001);
        band = (float)CONE_ROUGH * (1.0f + slope);
    }
    // The size of what a vector has across the axis, along which it is that long.
    inline Reals aside(const Vector& of, Reals along) const {
        const Vector across = { of.x - way.x * along, of.y - way.y * along, of.z - way.z * along };
        return __builtin_elementwise_sqrt(across.dot(across));
    }
    // Those that may meet the cone, as bits. through: of these, those that its axis may meet; covers: those that may
    // hide every ray of it.
    inline int possible(const float* block, int& through, int& covers) const {
        const Vector a = rows(block) - apex, e = rows(block + 3 * TREE_LANES), f = rows(block + 6 * TREE_LANES);
        const Vector b = a + e, c = a + f, sum = a + b + c;
        const Reals size = *(const Reals*)(block + 9 * TREE_LANES), rough = (float)CONE_ROUGH, none = 0.0f;
        const Reals one = a.dot(way), two = b.dot(way), three = c.dot(way);
        const Reals nearest = least(least(one, two), three), farthest = most(most(one, two), three);
        // A plane through the apex, on the side of the triangle's middle.
        const Reals middle = one + two + three;
        const Vector side = { sum.x - way.x * middle, sum.y - way.y * middle, sum.z - way.z * middle };
        const Reals wide = slope * __builtin_elementwise_sqrt(side.dot(side));
        const Reals pad = band * sum.sum() * (0.25f + a.sum() + b.sum() + c.sum());
        const Reals beside =
            least(least(side.dot(a) - wide * one, side.dot(b) - wide * two), side.dot(c) - wide * three);
        Masks apart = (beside > pad) | (nearest > end + rough) | (farthest < -rough) | (size < none);
        // The triangle's plane, of which all of the cone may be on one side. grown: the normal, had nothing cancelled.
        const Vector normal = e.cross(f), grown = e.absolutes().cross_sum(f.absolutes());
        const Reals off = normal.dot(a), sign = off < none ? (Reals)-1.0f : (Reals)1.0f, far_off = off * sign;
        const Reals floor = 1e-15f, all = grown.x + grown.y + grown.z;
        const Reals doubt = rough * (0.125f * grown.dot(a.absolutes()) + 0.0625f * all) + floor;
        const Reals along = normal.dot(way), reach = most(least(end, farthest + rough), none);
        const Reals leaning = along * sign + slope * aside(normal, along) + 0.25f * band * all;
        apart |= (far_off > doubt) & (far_off > reach * leaning + doubt);
        // Planes through the apex and an edge, of which the triangle is on one side.
        const Vector first = a.cross(e), last = f.cross(a), other = normal - first - last;
        const Reals edge = band * size * (0.25f + 0.4f * a.sum() + 0.2f * size) + floor;
        const Masks sided = far_off > doubt;
        Masks pierced = -1, inside = -1;
        outside(first, sign, edge, sided, apart, pierced, inside);
        outside(other, sign, edge, sided, apart, pierced, inside);
        outside(last, sign, edge, sided, apart, pierced, inside);
        const int meet = ~bits(apart) & 0xffff;
        through = meet & bits(pierced);
        covers = meet & bits(inside);
        return meet;
    }
    inline void outside(const Vector& plane, Reals sign, Reals pad, Masks sided, Masks& apart, Masks& pierced,
                        Masks& inside) const {
        const Reals along = plane.dot(way), turned = along * sign, wide = slope * aside(plane, along);
        apart |= sided & (turned + wide < -pad);
        pierced &= ~(sided & (turned < -pad));
        inside &= ~(sided & (turned - wide < -pad));
    }
};
#endif
