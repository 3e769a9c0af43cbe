// needs: exact/arithmetic.h
// float64 whose operators round each operation once and contract none: the same bits on every device.
struct Rounded {
    double number;

    inline Rounded(double number = 0.0) : number(number) {}
    inline Rounded operator+(Rounded y) const { return Arithmetic::add(number, y.number); }
    inline Rounded operator-(Rounded y) const { return Arithmetic::sub(number, y.number); }
    inline Rounded operator*(Rounded y) const { return Arithmetic::mul(number, y.number); }
    inline Rounded operator/(Rounded y) const { return number / y.number; }
    inline Rounded operator-() const { return -number; }
    inline bool operator<(Rounded y) const { return number < y.number; }
    inline bool operator>(Rounded y) const { return number > y.number; }
    inline bool operator<=(Rounded y) const { return number <= y.number; }
    inline bool operator>=(Rounded y) const { return number >= y.number; }
    inline bool operator==(Rounded y) const { return number == y.number; }
    inline Rounded absolute() const { return Arithmetic::absolute(number); }
    inline Rounded root() const { return sqrt(number); }
};
// Three of them.
struct Triple {
    Rounded x, y, z;

    inline Triple() {}
    inline Triple(Rounded x, Rounded y, Rounded z) : x(x), y(y), z(z) {}
    inline explicit Triple(const wp::vec3d& v) : x(v[0]), y(v[1]), z(v[2]) {}
    inline Triple operator+(const Triple& o) const { return Triple(x + o.x, y + o.y, z + o.z); }
    inline Triple operator-(const Triple& o) const { return Triple(x - o.x, y - o.y, z - o.z); }
    inline Triple operator-() const { return Triple(-x, -y, -z); }
    inline Triple operator*(Rounded s) const { return Triple(x * s, y * s, z * s); }
    inline Rounded dot(const Triple& o) const { return x * o.x + y * o.y + z * o.z; }
    inline Triple cross(const Triple& o) const {
        return Triple(y * o.z - z * o.y, z * o.x - x * o.z, x * o.y - y * o.x);
    }
    // Of what they are without their signs: at least the length.
    inline Rounded sum() const { return x.absolute() + y.absolute() + z.absolute(); }
    inline Rounded length() const { return dot(*this).root(); }
    inline bool same(const Triple& o) const { return x == o.x && y == o.y && z == o.z; }
};
