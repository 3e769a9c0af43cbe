# SPDX-License-Identifier: Apache-2.0
"""Frames with sphere lights: as many point lights in batches or, where the pipeline can answer for all points of a
sample at once, one walk for every 64 of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.engine.band import Band
from shadow_tracer.gpu.engine.gather import Traced, gather_stages
from shadow_tracer.gpu.visibility import sphere_points
from shadow_tracer.gpu.visibility.queries import MASK, MASK_POINTS
from shadow_tracer.scene.lights import HardLight, Light


def trace_spheres(
    working: Sequence[Band],
    lights: Sequence[Light],
    together: int,
    trace: Callable[[Sequence[HardLight], bool], Traced],
    whole: Stages,
) -> Traced:
    """States of all lights.

    Args:
        working: the bands of the frame.
        together: the most hard lights of a batch.
        trace: traces hard lights; whether they are the first of the frame.
        whole: times of what is done for all bands at once.
    """
    masks = MASK in working[0].pipeline.traits.queries
    tally = sphere_points.Tally(lights, sum(band.samples.count for band in working), together, masks)
    counters: dict[str, int] = {}
    stages: dict[str, float] = {}
    for first, batch in tally.batches():
        traced = trace(batch, first == 0)
        tally.add(first, traced.states)
        counters, stages = sphere_points.add_up(counters, traced.counters), traced.stages
        for place, number, sphere in tally.spheres(first, len(batch)):
            for begin in range(0, sphere.samples, MASK_POINTS):
                points = sphere.points[begin : begin + MASK_POINTS]
                for band in working:
                    seen, counts = band.see(place, points)
                    tally.count(number, band.samples.first, seen)
                    counters = {name: value + counts.get(name, 0) for name, value in counters.items()}
            stages = gather_stages(whole, working)
    states, reached = tally.result()
    return Traced(states, stages, counters, reached)
