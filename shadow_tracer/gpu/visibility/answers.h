// arguments: Answers answers
// constants: SHADOWED PENDING
struct Settle {
    // An uncertain pair: it waits for the exact decision, or its ray for a further pass.
    static inline void pair(const Answers& answers, int sample, int triangle) {
        if (answers.states.data[sample] == SHADOWED)
            return;
        wp::atomic_add(&answers.resume.data[sample], 1);
        // As queue.enqueue: the counter stops behind the capacity.
        const int capacity = answers.queue.shape[0];
        int slot = answers.queue_count.data[0];
        if (slot <= capacity)
            slot = wp::atomic_add(&answers.queue_count.data[0], 1);
        if (slot < capacity)
            answers.queue.data[slot] = wp::vec2i(sample, triangle);
        else
            answers.states.data[sample] = PENDING;
    }
};
