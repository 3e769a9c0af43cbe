// needs: query
// The triangles that a ray was shown last, where most lie in several cells.
struct Mailboxes {
    enum { MAILBOXES = 16 };
    int shown[MAILBOXES];

    inline Mailboxes() {
        for (int k = 0; k < MAILBOXES; ++k)
            shown[k] = -1;
    }
    // Shows those of the members `first` to before `last` that are not among them; true if that was enough.
    inline bool show(const wp::array_t<int>& members, int first, int last, Query1& query) {
        for (int k = first; k < last; ++k) {
            const int triangle = members.data[k];
            int& box = shown[triangle % MAILBOXES];
            if (box == triangle)
                continue;
            box = triangle;
            if (query.visit(triangle))
                return true;
        }
        return false;
    }
};
