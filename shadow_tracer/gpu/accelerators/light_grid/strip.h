// cpu
// constants: TILE_RAYS SEGMENT
// arguments: Tiles tiles, Pieces pieces
// A segment of a light: pieces side by side, of up to SEGMENT samples of each of their rows.
struct Strip {
    int rows, wide, width, samples; // of a piece; of the image
    int x, top, n;                  // the first sample of it, and samples of a row
    int first, count;               // pieces, by their numbers among those of a light

    inline Strip(int number, const Tiles& tiles, const Pieces& pieces)
        : rows(pieces.rows), wide(TILE_RAYS / rows), width(pieces.width), samples(tiles.samples) {
        const int beside = (width + SEGMENT - 1) / SEGMENT, strip = number / beside;
        x = SEGMENT * (number - beside * strip);
        top = rows * strip;
        n = width - x < SEGMENT ? width - x : SEGMENT;
        first = strip * pieces.across + x / wide;
        count = (n + wide - 1) / wide;
    }
    // Its pieces from one on to the one before another.
    inline Strip part(int from, int to) const {
        Strip some = *this;
        some.x += wide * from;
        some.n = n - wide * from < wide * (to - from) ? n - wide * from : wide * (to - from);
        some.first += from;
        some.count = to - from;
        return some;
    }
    // The number of the first sample of a row, and how many there are.
    inline size_t at(int row) const { return (size_t)(top + row) * width + x; }
    inline int of_row(int row) const {
        const int there = samples - (int)at(row);
        return there <= 0 ? 0 : n < there ? n : there;
    }
};
