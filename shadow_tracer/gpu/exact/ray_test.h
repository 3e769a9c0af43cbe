// needs: device/lanes.h exact/camera_record.h
// lanes
// LANES rays, as (x, -y), against the record of a triangle in float32.
struct WIDE(RayTest) {
    REAL low, high; // bounds of the inverse depth
    MASK closer;    // rays that surely meet the triangle, and in front of what they have met
    int inside;     // as bits: rays that surely meet it

    inline void measure(const float* record, REAL x, REAL y, float magnitude) {
        const float* n = record + CameraRecord::Q;
        const REAL q = n[0] * x + (n[1] * y + n[2]);
        const float slack = record[CameraRecord::DEPTH_BOUND] * magnitude;
        low = q - slack;
        high = q + slack;
    }
    // The rays, as bits, that may meet the triangle, and not behind what they have met; `least` and `most` are the
    // bounds of that, `magnitude` is |x| + |y| + 2 or more.
    inline int judge(const float* record, REAL x, REAL y, float magnitude, REAL least, REAL most) {
        typedef WIDE(Lanes) Lanes;
        const float *ab = record, *bc = record + 4, *ca = record + 8;
        const REAL e0 = ab[0] * x + (ab[1] * y + ab[2]);
        const REAL e1 = bc[0] * x + (bc[1] * y + bc[2]);
        const REAL e2 = ca[0] * x + (ca[1] * y + ca[2]);
        const REAL e01 = e0 < e1 ? e0 : e1, e = e01 < e2 ? e01 : e2;
        const float bound = record[CameraRecord::EDGE_BOUND] * magnitude;
        const MASK beside = e < -bound;
        if (Lanes::bits(beside) == Lanes::ALL)
            return 0;
        measure(record, x, y, magnitude);
        const int left = ~Lanes::bits(beside | (high < least)) & Lanes::ALL;
        if (left == 0)
            return 0;
        const MASK sure = e > bound;
        closer = sure & (low > most);
        inside = Lanes::bits(sure);
        return left;
    }
};
