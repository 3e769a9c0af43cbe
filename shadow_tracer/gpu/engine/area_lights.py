# SPDX-License-Identifier: Apache-2.0
"""Frames with lights that have a size, or in which some meshes cast nothing: in batches of hard lights or, where the
pipeline can answer for all points of a sample at once, one walk for every 64 of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.engine.band import Band
from shadow_tracer.gpu.engine.gather import Traced, gather_stages
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility import light_points
from shadow_tracer.gpu.visibility.queries import MASK, MASK_POINTS
from shadow_tracer.scene.lights import HardLight, Light


def trace_area_lights(
    working: Sequence[Band],
    scene: SceneBuffers,
    lights: Sequence[Light],
    together: int,
    trace: Callable[[Sequence[HardLight], bool], Traced],
    whole: Stages,
) -> Traced:
    """States of all lights.

    Args:
        working: the bands of the frame.
        scene: the world, in which the meshes that a light ignores cast nothing for the time of its batches.
        together: the most hard lights of a batch.
        trace: traces hard lights; whether they are the first of the frame.
        whole: times of what is done for all bands at once.
    """
    masks = MASK in working[0].pipeline.traits.queries
    tally = light_points.Tally(lights, sum(band.samples.count for band in working), together, masks)
    counters: dict[str, int] = {}
    stages: dict[str, float] = {}
    for batch in tally.batches():
        scene.leave_out(batch.ignored)
        traced = trace(batch.lights, batch.first == 0)
        tally.add(batch, traced.states)
        counters, stages = light_points.add_up(counters, traced.counters), traced.stages
        for place, number, light in tally.area_lights(batch):
            points = light.homogeneous_points
            for begin in range(0, light.samples, MASK_POINTS):
                for band in working:
                    seen, counts = band.see(place, points[begin : begin + MASK_POINTS])
                    tally.put(number, begin, band.samples.first, seen)
                    counters = {name: value + counts.get(name, 0) for name, value in counters.items()}
            stages = gather_stages(whole, working)
    scene.leave_out(())
    states, reaching = tally.result()
    return Traced(states, stages, counters, reaching)
