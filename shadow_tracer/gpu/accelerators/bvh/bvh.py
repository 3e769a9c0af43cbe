# SPDX-License-Identifier: Apache-2.0
"""DOC"""

from __future__ import annotations

from shadow_tracer.gpu.accelerators.bvh.scene_tree import KINDS
from shadow_tracer.gpu.accelerators.bvh.tree import Tree
from shadow_tracer.gpu.accelerators.interface import Context, Traits
from shadow_tracer.gpu.accelerators.walker import Walk, Walker
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST, MASK

# Bounds of what roundings do to the planes of a triangle of size 1, and the least bound.
native.constants(BLOCK_BAND=2.0**-17, BLOCK_FLOOR=1e-30)
# Rays of a bundle are no farther from its middle, in units of the scene's extent, and so many nodes and blocks for each
# of them is the most that it visits: other packets are cut in two.
native.constants(WIDEST=2.0**-6, PATIENCE=4)
# Of rays in a packet, in units of the extent: longer ones are shown everything.
native.constants(LONGEST=1e100)

_QUERIES = (ANY_HIT, MASK, CLOSEST)
# On the CPU: rays one by one, and in packets of sixteen.
SINGLE = Walk("accelerators/bvh/sixteen.h", Tree, queries=_QUERIES)
PACKETS = SINGLE | Walk("accelerators/bvh/packets.h", Tree, lanes=16)
_PAIRS = Walk("accelerators/bvh/pairs.h", Tree, queries=_QUERIES)
_THREADED = Walk("accelerators/bvh/threaded.h", Tree, queries=_QUERIES)


class Bvh(Walker):
    """The ``bvh`` pipeline."""

    traits = Traits(masks=True)

    def __init__(self, variant: str, context: Context) -> None:
        super().__init__(context)
        kind = KINDS[variant]
        self._tree = context.shared.take(kind, lambda: kind(context))
        self.walk = _THREADED if kind.threaded else PACKETS if forms.wide(context.frame.device) else _PAIRS

    def build(self) -> Tree:
        """Refit or build the tree, unless another share of the rays has done so."""
        return self._tree.follow()
