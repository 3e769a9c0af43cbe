// The triangles that a ray was shown last, where most lie in several cells.
struct Mailboxes {
    enum { MAILBOXES = 16 };
    int shown[MAILBOXES];

    inline Mailboxes() {
        for (int k = 0; k < MAILBOXES; ++k)
            shown[k] = -1;
    }
    // Whether it is one of them; it is from now on.
    inline bool hold(int triangle) {
        int& box = shown[triangle % MAILBOXES];
        if (box == triangle)
            return true;
        box = triangle;
        return false;
    }
};
