// needs: exact/decision.h
// arguments: Answers answers
// constants: LIT SHADOWED OPEN RETESTED EXACT COUNTER_ROWS
// A pair of a ray and a triangle that the filter cannot decide.
#if defined(__CUDA_ARCH__)
#define RARE static inline
#else
#define RARE static __attribute__((noinline))
#endif
struct Settle {
    // The exact decision, here and now; true if the ray is in shadow.
    RARE bool decide(const Answers& answers, int ray, int triangle) {
        const int place = ray / answers.samples;
        const wp::vec3i& corner = answers.triangles.data[triangle];
        const wp::vec3d* vertices = answers.vertices.data;
        const int answer =
            Decision::of(answers.positions.data[ray - place * answers.samples], answers.lights.data[place].light,
                         vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]);
        wp::int64* counter = answers.counters.data + (size_t)(ray & (COUNTER_ROWS - 1)) * answers.counters.shape[1];
        wp::atomic_add(counter + RETESTED, (wp::int64)1);
        if (answer >> 1)
            wp::atomic_add(counter + EXACT, (wp::int64)(answer >> 1));
        if (answer & 1)
            answers.states.data[ray] = SHADOWED;
        return answer & 1;
    }
    // Where there is a queue the pair waits on it, or its ray is left open if it is full; true if nothing more need be
    // shown to the ray.
    static inline bool pair(const Answers& answers, int ray, int triangle) {
        if (answers.states.data[ray] != LIT)
            return true;
        const int capacity = answers.queue.shape[0];
#if !defined(__CUDA_ARCH__)
        if (capacity == 0)
            return decide(answers, ray, triangle);
#endif
        // The counter stops behind the capacity, though a thread may be late by one: with more uncertain pairs than
        // integers it would come round.
        int slot = answers.queue_count.data[0];
        if (slot <= capacity)
            slot = wp::atomic_add(&answers.queue_count.data[0], 1);
        if (slot < capacity) {
            answers.queue.data[slot] = wp::vec2i(ray, triangle);
            return false;
        }
        answers.states.data[ray] = OPEN;
        return true;
    }
};
#undef RARE
