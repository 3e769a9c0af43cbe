// constants: LAMP_SPOT LAMP_ENDLESS LAMP_TABLE LAMP_LINE LAMP_DISC LAMP_RECTANGLE LAMP_SPHERE
// arguments: Lamp lamp
// Irradiance of a sample by the points of a lamp that reach it; irradiance.py says from where the laws are.
struct Irradiance {
    typedef wp::vec3d Vector;
    typedef unsigned long long Bits;

    static inline double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
    static inline Vector minus(const Vector& a, const Vector& b) {
        return Vector(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    }
    static inline Vector plus(const Vector& a, double s, const Vector& b) {
        return Vector(a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]);
    }
    static inline double larger(double a, double b) { return a > b ? a : b; }
    static inline double smaller(double a, double b) { return a < b ? a : b; }
    static inline bool finite(double a) { return a - a == 0.0; }
    static inline double nan() { return HUGE_VAL - HUGE_VAL; }
    static inline bool reaches(Bits bits, int point) { return (bits >> point & 1) != 0; }

    // A unit vector, or false.
    static inline bool unit(const Vector& raw, Vector& n) {
        const double square = dot(raw, raw);
        if (square > 1e-200 && square < 1e200) {
            const double inverse = 1.0 / sqrt(square);
            n = Vector(inverse * raw[0], inverse * raw[1], inverse * raw[2]);
            return true;
        }
        const double x = fabs(raw[0]), y = fabs(raw[1]), z = fabs(raw[2]);
        const double most = larger(x, larger(y, z));
        if (!(most > 0.0) || !finite(x) || !finite(y) || !finite(z))
            return false;
        const Vector v(raw[0] / most, raw[1] / most, raw[2] / most);
        const double length = sqrt(dot(v, v));
        n = Vector(v[0] / length, v[1] / length, v[2] / length);
        return true;
    }

    // Half the angle that an edge spans, times the cosine between the normal and the plane of edge and sample.
    static inline double edge(const Vector& a, const Vector& b, const Vector& n) {
        const Vector across(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
        const double length = sqrt(dot(across, across));
        return length > 0.0 ? 0.5 * atan2(length, dot(a, b)) * dot(across, n) / length : 0.0;
    }
    // What of a flat convex polygon is above the plane of the sample; clipped corner by corner.
    static inline double polygon(const wp::array_t<Vector>& corners, int count, const Vector& p, const Vector& n) {
        double total = 0.0;
        Vector leaves(0.0, 0.0, 0.0), enters(0.0, 0.0, 0.0);
        const Vector first = minus(corners.data[0], p);
        const double above_first = dot(first, n);
        Vector a = first;
        double above_a = above_first;
        for (int k = 1; k <= count; ++k) {
            const Vector b = k < count ? minus(corners.data[k], p) : first;
            const double above_b = k < count ? dot(b, n) : above_first;
            const bool goes = above_a >= 0.0 && above_b < 0.0, comes = above_a < 0.0 && above_b >= 0.0;
            Vector from = a, to = b;
            if (goes || comes) {
                const Vector cut = plus(a, above_a / (above_a - above_b), minus(b, a));
                if (goes)
                    leaves = to = cut;
                else
                    enters = from = cut;
            }
            if (above_a >= 0.0 || above_b >= 0.0)
                total += edge(from, to, n);
            a = b;
            above_a = above_b;
        }
        return fabs(total + edge(leaves, enters, n));
    }

    // A whole disc.
    static inline double disc(const Lamp& lamp, const Vector& p, const Vector& n) {
        const Vector v = minus(lamp.centre, p);
        const double height = dot(v, lamp.axis), tilt = dot(n, lamp.axis); // negative on the side it shines to
        if (fabs(dot(v, n)) < lamp.radius * sqrt(larger(0.0, 1.0 - tilt * tilt)))
            return polygon(lamp.corners, lamp.corner_count, p, n);
        const Vector radial = plus(v, -height, lamp.axis);
        const double a2 = dot(radial, radial), h2 = height * height, r2 = lamp.radius * lamp.radius;
        const double far = a2 - h2 - r2, edge = a2 + h2 - r2;
        const double root = sqrt(edge * edge + 4.0 * h2 * r2), both = r2 + a2 + h2 + root;
        if (!(root * both > 0.0))
            return 0.0;
        // Both less twice a2 is root less far, without a difference of nearly equal numbers.
        const double up = far > 0.0 ? 4.0 * a2 * h2 / (root + far) : root - far;
        const double upright = (height > 0.0 ? tilt : -tilt) * up;
        // Below zero where all of it is below.
        return larger(0.0, lamp.pi * r2 / (root * both) * (upright + 2.0 * fabs(height) * dot(n, radial)));
    }

    // A line, as it lies from a sample.
    struct Line {
        double begin, distance, inverse, up, along, low, high;

        inline Line(const Lamp& lamp, const Vector& p, const Vector& n) {
            const Vector v = minus(lamp.centre, p);
            begin = dot(v, lamp.axis); // where it starts, from the foot of the sample's perpendicular
            const Vector foot = plus(v, -begin, lamp.axis);
            distance = sqrt(dot(foot, foot));
            inverse = distance > 0.0 ? 1.0 / distance : 0.0;
            up = dot(n, foot) * inverse;
            along = dot(n, lamp.axis);
            low = -HUGE_VAL, high = HUGE_VAL;
            const double first = dot(n, v);
            if (first >= 0.0 && first + along * lamp.length >= 0.0)
                return;
            // Above the sample's plane are places on the line between these.
            const double meets = -distance * up / (along == 0.0 ? 1.0 : along);
            low = along > 0.0 ? meets : -HUGE_VAL;
            high = along < 0.0 ? meets : along == 0.0 && !(up > 0.0) ? -HUGE_VAL : HUGE_VAL;
        }
        inline double cut(double at) const { return smaller(larger(begin + at, low), high); }
        // Of the piece between two distances from the start.
        inline double piece(double from, double to, bool lambert) const {
            const double s = cut(from), e = cut(to), h = distance, h2 = h * h, span = e - s;
            if (!(span > 0.0))
                return 0.0;
            double found;
            if (lambert) {
                const double both = (h2 + s * s) * (h2 + e * e), turn = atan2(h * span, h2 + s * e);
                const double rest = up * span * (h2 - s * e) + h * along * span * (s + e);
                found = 0.5 * (up * turn * inverse + rest / both);
            } else {
                const double to_s = sqrt(h2 + s * s), to_e = sqrt(h2 + e * e);
                found = up * inverse * (e / to_e - s / to_s) + along * (1.0 / to_s - 1.0 / to_e);
            }
            return finite(found) ? larger(found, 0.0) : found;
        }
    };
    // A tube, of which each point stands for a piece; pieces in a row are one.
    static inline double line(const Lamp& lamp, const Vector& p, const Vector& n, Bits bits, bool whole) {
        const Line line(lamp, p, n);
        const bool beside = line.begin > 0.0 || line.begin + lamp.length < 0.0, on = line.distance == 0.0;
        if (!beside && (line.distance < lamp.radius || on))
            return nan(); // inside there is no answer
        if (on && lamp.lambert)
            return 0.0; // nothing is seen of it
        if (whole)
            return line.piece(0.0, lamp.length, lamp.lambert != 0);
        double total = 0.0;
        const double step = lamp.length / lamp.count;
        for (int k = 0; k < lamp.count; ++k) {
            if (!reaches(bits, k))
                continue;
            const int first = k;
            while (k + 1 < lamp.count && reaches(bits, k + 1))
                ++k;
            total += line.piece(step * first, k + 1 == lamp.count ? lamp.length : step * (k + 1), lamp.lambert != 0);
        }
        return total;
    }

    // What of a lamp of even radiance arrives, as its points say: each with how it is turned.
    static inline double part_of_flat(const Lamp& lamp, const Vector& p, const Vector& n, Bits bits) {
        double some = 0.0, all = 0.0;
        for (int k = 0; k < lamp.count; ++k) {
            const Vector v = minus(lamp.points.data[k], p);
            const double square = dot(v, v), away = -dot(v, lamp.axis);
            const double turned = lamp.two_sided ? fabs(away) : larger(away, 0.0);
            const double part = turned * larger(dot(v, n), 0.0) / (square * square);
            all += part;
            some += reaches(bits, k) ? part : 0.0;
        }
        return all == 0.0 ? 0.0 : some / all;
    }
    static inline double sphere(const Lamp& lamp, const Vector& p, const Vector& n, Bits bits, bool whole) {
        const Vector middle = minus(lamp.centre, p);
        const double square = dot(middle, middle), up = dot(middle, n), r2 = lamp.radius * lamp.radius;
        if (!(square > r2))
            return nan();
        if (up <= -lamp.radius)
            return 0.0;
        const double facing = lamp.pi * r2 / square, cosine = up / sqrt(square);
        if (whole && up >= lamp.radius)
            return facing * cosine;
        // Where the sample's plane cuts it, points also say what of it is above.
        double some = 0.0, all = 0.0;
        Vector seen(0.0, 0.0, 0.0);
        for (int k = 0; k < lamp.count; ++k) {
            const Vector v = minus(lamp.points.data[k], p);
            const double s = dot(v, v);
            const double turned = larger(-dot(v, minus(lamp.points.data[k], lamp.centre)), 0.0) / (s * s);
            seen = plus(seen, turned, v);
            const double part = turned * larger(dot(v, n), 0.0);
            all += part;
            some += reaches(bits, k) ? part : 0.0;
        }
        const double length = sqrt(dot(seen, seen));
        if (!(length > 0.0))
            return nan();
        return facing * (up >= lamp.radius ? cosine * some / all : some / length);
    }

    // Between which two of ascending angles, and how far from the first to the second.
    static inline int between(const wp::array_t<double>& angles, int count, double at, double& part) {
        int low = 0, high = count - 1;
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            if (at >= angles.data[middle])
                low = middle;
            else
                high = middle;
        }
        part = (at - angles.data[low]) / (angles.data[low + 1] - angles.data[low]);
        part = smaller(larger(part, 0.0), 1.0);
        return low;
    }
    // Of a table, in a direction away from the light.
    static inline double intensity(const Lamp& lamp, const Vector& way) {
        const double x = dot(way, lamp.zero), y = dot(way, lamp.side), down = dot(way, lamp.axis);
        const double vertical = atan2(sqrt(x * x + y * y), down);
        if (vertical < lamp.vertical.data[0] || vertical > lamp.vertical.data[lamp.rows - 1])
            return 0.0;
        double up, on;
        const int row = between(lamp.vertical, lamp.rows, vertical, up);
        const double* near = lamp.values.data + row;
        if (lamp.columns == 1)
            return (1.0 - up) * near[0] + up * near[1];
        double around = atan2(y, x);
        around = around < 0.0 ? around + 2.0 * lamp.pi : around;
        near += lamp.rows * between(lamp.horizontal, lamp.columns, around, on);
        const double* far = near + lamp.rows;
        return (1.0 - on) * ((1.0 - up) * near[0] + up * near[1]) + on * ((1.0 - up) * far[0] + up * far[1]);
    }
    static inline double points(const Lamp& lamp, const Vector& p, const Vector& n, Bits bits) {
        double total = 0.0;
        for (int k = 0; k < lamp.count; ++k) {
            if (!reaches(bits, k))
                continue;
            if (lamp.kind == LAMP_ENDLESS) {
                total += lamp.weights.data[k] * larger(-dot(n, lamp.points.data[k]), 0.0);
                continue;
            }
            const Vector v = minus(lamp.points.data[k], p);
            const double square = dot(v, v), facing = larger(dot(v, n), 0.0);
            if (lamp.kind == LAMP_SPOT) {
                total += larger(-dot(v, lamp.axis), 0.0) * facing / (square * square);
                continue;
            }
            const double there = lamp.kind == LAMP_TABLE ? intensity(lamp, Vector(-v[0], -v[1], -v[2])) : 1.0;
            total += there * facing / (square * sqrt(square));
        }
        return total;
    }

    static inline double of(const Lamp& lamp, const Vector& p, const Vector& n, Bits bits) {
        const bool whole = bits == (lamp.count < 64 ? ((Bits)1 << lamp.count) - 1 : ~(Bits)0);
        switch (lamp.kind) {
        case LAMP_LINE:
            return line(lamp, p, n, bits, whole);
        case LAMP_DISC:
            return disc(lamp, p, n) * (whole ? 1.0 : part_of_flat(lamp, p, n, bits));
        case LAMP_RECTANGLE:
            return polygon(lamp.corners, lamp.corner_count, p, n) * (whole ? 1.0 : part_of_flat(lamp, p, n, bits));
        case LAMP_SPHERE:
            return sphere(lamp, p, n, bits, whole);
        default:
            return points(lamp, p, n, bits);
        }
    }
    static inline double one(int i, const Lamp& lamp, const wp::array_t<Vector>& positions,
                             const wp::array_t<Vector>& normals, const wp::array_t<wp::uint64>& bits) {
        if (bits.data[i] == 0)
            return 0.0;
        Vector n;
        if (!unit(normals.data[i], n))
            return nan();
        const double found = lamp.scale * of(lamp, positions.data[i], n, bits.data[i]);
        return finite(found) ? found : nan();
    }
};
