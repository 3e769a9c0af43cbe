# SPDX-License-Identifier: Apache-2.0
"""Declared capacities. They are known before anything is allocated, so they live with the scene and not with the
buffers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

# No array has 2^31 elements, so that elements can be counted in 32 bits. The largest are: 12 floats for each triangle
# and for 128 more of every light; 5 for each ray, of which shares have room for a quarter more; two keys for each
# entry; a state for each ray and light. The counter of a full queue runs past its capacity, by one for each thread that
# was late to see it full.
LIMITS = {
    "max_triangles": 2**31 // 12 - 128 * 64,
    "max_rays": 2**28,
    "max_lights": 64,
    "queue_capacity": 2**30,
    "grid_entries": 2**30 - 1,
    "max_sample_sets": 16,
}
_MOST_STATES = 2**30 + 2**29


@dataclass(frozen=True)
class Bounds:
    """Capacities of every device buffer, fixed when a tracer is made. All are positive integers.

    Args:
        max_triangles: triangles of all meshes together; vertices are bounded by three times as many. Room for several
            times the triangles of the scene keeps what is known of them from several lights.
        max_rays: pixels of a depth image; :meth:`ShadowTracer.occluded` works in pieces of this size. Room for several
            images lets ``light_grid`` trace as many lights together.
        max_lights: lights of one frame.
        queue_capacity: sample/triangle pairs that float32 cannot decide, waiting for the exact decision on a GPU (the
            CPU decides them where it finds them); the node queues of the breadth-first variants have an eighth of it
            for each level. A full queue costs time (counted in ``overflow_passes``), never an answer.
        grid_entries: (tile, triangle) entries of pipeline ``light_grid`` and of depth cameras. Too few cost passes
            (counted in ``overflow_passes``), never an answer. For grids and trees, such as ``uniform_grid`` and
            ``kd_tree``, memberships of triangles in cells; too few make larger cells.
        max_sample_sets: sets of samples (``ShadowTracer.trace(samples=)``) that keep what can be used again; each has
            buffers for all the other bounds, the scene aside.

    Raises:
        ValueError: a capacity is not a positive integer or too large to count with; the message names it and its limit.
    """

    max_triangles: int = 1_000_000
    max_rays: int = 1_310_720
    max_lights: int = 16
    queue_capacity: int = 1_048_576
    grid_entries: int = 4_194_304
    max_sample_sets: int = 1

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            limit = LIMITS[item.name]
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 1 <= value <= limit:
                raise ValueError(f"bounds.{item.name}: expected an integer from 1 to {limit}, got {value!r}")
            object.__setattr__(self, item.name, int(value))
        states = self.max_rays * self.max_lights
        if states > _MOST_STATES:
            raise ValueError(
                f"bounds.max_rays: expected at most {_MOST_STATES} for max_rays * max_lights, a state each, got "
                f"{self.max_rays} * {self.max_lights} = {states}"
            )
