# SPDX-License-Identifier: Apache-2.0
"""Frames with lights that have a size, or in which some meshes cast nothing: in batches of hard lights or, where the
pipeline can answer for all points of a sample at once, one walk for every 64 of them.

A bundle of rays to a large light, or to one with something close around it, meets so many triangles that rays one by
one cost less. So some samples try the bundle out first, and the nodes that they visit and the triangles that they are
shown are counted: never the time, which other programs change. Both ways give the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from shadow_tracer.gpu.accelerators.interface import Accelerator
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.device.workers import Job
from shadow_tracer.gpu.engine.band import Band
from shadow_tracer.gpu.engine.gather import Traced, gather_stages
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility import light_points
from shadow_tracer.gpu.visibility.queries import MASK, MASK_POINTS
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import Light

# Samples that try a bundle out; fewer than so many times as many samples in all go without.
PILOT, WORTH = 256, 8

Run = Callable[[Sequence[Job]], None]
_Found = TypeVar("_Found")


def trace_area_lights(
    working: Sequence[Band],
    scene: SceneBuffers,
    lights: Sequence[Light],
    together: int,
    trace: Callable[[light_points.Batch], Traced],
    apart: Accelerator,
    run: Run,
    whole: Stages,
) -> Traced:
    """States of all lights.

    Args:
        working: the bands of the frame.
        scene: the world, in which the meshes that a light ignores cast nothing for the time of its batches.
        together: the most hard lights of a batch.
        trace: traces the hard lights of a batch, or finds where they shine.
        apart: what traces the points of a light one by one.
        run: does what each band asks for all points of a light, side by side or in turn.
        whole: times of what is done for all bands at once.
    """
    masks = MASK in working[0].pipeline.traits.queries
    tally = light_points.Tally(lights, sum(band.samples.count for band in working), together, masks)
    counters: dict[str, int] = {}
    stages: dict[str, float] = {}
    for batch in tally.batches():
        scene.leave_out(batch.ignored)
        for band in working:  # here and not in what may be recorded: a replay does not come by
            band.follow()
        traced = trace(batch)
        tally.add(batch, traced.states)
        counters, stages = light_points.add_up(counters, traced.counters), traced.stages
        for place, number, light in tally.area_lights(batch):
            points = light.homogeneous_points
            bundled, spent = _is_bundle(run, working, place, points[:MASK_POINTS], apart, scene.triangle_count)
            counters = _plus(counters, spent)
            if not bundled:
                tally.divide(number)
                continue
            for begin in range(0, light.samples, MASK_POINTS):
                some = points[begin : begin + MASK_POINTS]
                found = _each(run, working, Band.see, place, some)
                for band, (seen, counts) in zip(working, found, strict=True):
                    tally.put(number, begin, band.samples.first, seen)
                    counters = _plus(counters, counts)
            stages = gather_stages(whole, working)
    scene.leave_out(())
    states, reaching = tally.result()
    return Traced(states, stages, counters, reaching)


def _each(run: Run, working: Sequence[Band], ask: Callable[..., _Found], *arguments: Any) -> list[_Found]:
    """What each band finds."""
    found: dict[Band, _Found] = {}

    def job(band: Band) -> None:
        begin = time.thread_time()
        found[band] = ask(band, *arguments)
        band.busy += time.thread_time() - begin

    run([partial(job, band) for band in working])
    return [found[band] for band in working]


def _is_bundle(
    run: Run, working: Sequence[Band], place: int, points: FloatArray, apart: Accelerator, triangles: int
) -> tuple[bool, dict[str, int]]:
    """Whether samples should ask about all points of a light together, and what it took to find out."""
    count = sum(band.samples.count for band in working)
    if count < WORTH * PILOT:
        return True, {}
    spent: dict[str, int] = {}
    for counts in _each(run, working, Band.try_out, place, points, count // PILOT):
        spent = _plus(counts, spent)
    if not spent:
        return True, {}
    together = bundle_cost(working[0].pipeline, len(points), spent)
    one_by_one = spent.pop("rays") * ray_cost(
        apart, triangles / count, working[0].samples.width > 0
    )  # they are asked again: not to be counted
    return together <= one_by_one, spent


def bundle_cost(pipeline: Accelerator, points: int, counts: dict[str, int]) -> float:
    """What bundles to so many points cost that took so much [ns]."""
    node, triangle, pair = pipeline.traits.bundle_costs
    return node * counts["nodes_visited"] + (triangle + pair * points) * counts["leaf_tests"]


def ray_cost(pipeline: Accelerator, triangles: float, image: bool) -> float:
    """What a ray costs, with so many triangles in the scene for each sample, which are an image or a list [ns]."""
    ray, triangle, listed = pipeline.traits.ray_costs
    return ray + triangle * triangles + (0.0 if image else listed)


def _plus(counters: dict[str, int], more: dict[str, int]) -> dict[str, int]:
    return {name: value + more.get(name, 0) for name, value in counters.items()}
