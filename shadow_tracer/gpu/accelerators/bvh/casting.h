// cpu
// constants: TREE_LANES TREE_NONE GAP_VERTEX COUNT_OF_BLOCKS COUNT_OF_WIDE_NODES
// arguments: Tree tree
// Which triangles of blocks, and which children of nodes with sixteen, still cast something while meshes are left out.
struct Casting {
    static inline void mark(int count, const wp::array_t<wp::vec3i>& triangles, const Tree& tree) {
        for (int block = 0; block < tree.counts.data[COUNT_OF_BLOCKS]; ++block) {
            const int* members = tree.members.data + TREE_LANES * (size_t)block;
            int casting = 0;
            for (int lane = 0; lane < TREE_LANES; ++lane) {
                const int member = members[lane];
                const bool there = member >= 0 && member < count;
                casting |= (int)(there && triangles.data[there ? member : 0][0] != GAP_VERTEX) << lane;
            }
            tree.casting_blocks.data[block] = casting;
        }
        // Children have greater numbers than their parent.
        for (int node = tree.counts.data[COUNT_OF_WIDE_NODES] - 1; node >= 0; --node) {
            const int* links = tree.links.data + TREE_LANES * (size_t)node;
            int casting = 0;
            for (int lane = 0; lane < TREE_LANES; ++lane) {
                const int link = links[lane];
                if (link != TREE_NONE)
                    casting |= (int)(below(link, tree) != 0) << lane;
            }
            tree.casting_nodes.data[node] = casting;
        }
    }
    static inline int below(int link, const Tree& tree) {
        return link < 0 ? tree.casting_blocks.data[~link] : tree.casting_nodes.data[link];
    }
};
