# SPDX-License-Identifier: Apache-2.0
"""A shared tracer in the state of a fresh one: it not only answers the same, it looks at the same."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Camera, PointLight, ShadowTracer

_LIGHTS = [PointLight("lamp", (0.5, 0.2, 2.5)), PointLight("other", (-3.0, 0.0, 4.0))]
_CAMERA = Camera(320, 240, 260.0, 260.0, 159.5, 119.5, geometry.look_at((-8.0, 0.3, 2.0), (0, 0, 1), (0, 0, 1)))


def _depth(rows: slice, columns: tuple[int, ...], times: float = 1.0) -> np.ndarray:
    """An image large enough to be cut between threads, of which only a few pixels of some rows hold something: every
    seventh, which are those that the anchor is found by, and in every seventh column from each of ``columns`` on."""
    depth = np.full((240, 320), np.nan, np.float32)
    every = np.random.default_rng(601).uniform(2.0, 12.0, depth.shape)
    for column in columns:
        depth[3::7, column::7] = times * every[3::7, column::7]
    depth[: rows.start] = depth[rows.stop :] = np.nan
    return depth


def _counters(tracer: ShadowTracer, form: str = probe.USUAL) -> dict[str, int]:
    tracer.scene.put("street", *geometry.street(np.random.default_rng(600), 100))
    counters = tracer.trace(_depth(slice(120, 240), (3,)), _CAMERA, _LIGHTS).counters
    if probe.wide(tracer.device) or form == probe.CUDA:
        return counters
    # Where many threads work side by side, what they look at depends on who comes first.
    return {name: counters[name] for name in ("rays", "triangles")}


def _use(tracer: ShadowTracer) -> None:
    """Leave behind all that frames leave behind: an anchor that also serves the frame above, cuts between threads,
    guesses at occluders, a second pipeline."""
    tracer.prepare_verify()
    tracer.scene.put("street", *geometry.street(np.random.default_rng(602), 100))
    for rows in (slice(0, 240), slice(0, 180), slice(60, 240)):
        tracer.trace(_depth(rows, (2, 3), 1.2), _CAMERA, _LIGHTS[::-1])
    tracer.front_face_culling = True


def test_a_used_tracer_is_brought_to_the_state_of_a_fresh_one(tracer: Any, tracers: Any, kernel_form: str) -> None:
    case = tracer.device, tracer.pipeline, tracer.variant
    fresh = ShadowTracer(tracer.pipeline, tracer.variant, tracer.device, tracer.bounds)
    untouched = fresh.choice
    expected = _counters(fresh, kernel_form)
    assert expected["rays"] > 0
    _use(tracer)
    bytes_in_use = tracer.device_bytes
    assert tracers(*case) is tracer and tracer.device_bytes < bytes_in_use
    assert tracer.choice == untouched, "auto has learned nothing"
    assert _counters(tracer, kernel_form) == expected
    _use(fresh)
    probe.reset(fresh)
    assert _counters(fresh, kernel_form) == expected, "nor does it matter what else the shared tracer has been used for"


@pytest.mark.wide
@pytest.mark.parametrize("names", ["cone_hierarchy/precise_sorted", "mesh_bvh/refit"])
def test_without_the_reset_counts_depend_on_earlier_frames(names: str) -> None:
    """Proof that the test above sees: an empty scene alone is not the state of a fresh tracer."""
    # In one band: where several are cut depends on times, and may be where the fresh one's are.
    tracer = ShadowTracer(*names.split("/"), device="cpu", threads=1)
    expected = _counters(tracer)
    _use(tracer)
    tracer.scene.clear()
    tracer.front_face_culling = False
    assert _counters(tracer) != expected
