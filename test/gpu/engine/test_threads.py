# SPDX-License-Identifier: Apache-2.0
"""Bands of the rays, worked on side by side: the same bits as one thread, whatever is cut where; and the threads
themselves."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import probe
import probe_accelerators
import pytest
import views

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    PointLight,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    SpotLight,
    SunDisc,
)
from shadow_tracer.gpu.device.workers import MOST, Workers, available_cores
from shadow_tracer.gpu.engine import area_lights, band, bands, frame
from shadow_tracer.gpu.occluders import seen as seen_triangles

_SIZE = 256
_COUNT = _SIZE * _SIZE
_VARIANTS = [("light_grid", "packed"), ("cone_hierarchy", "linear"), ("brute_force", "filtered")]
_WALKERS = [("mesh_bvh", "refit"), ("mesh_bvh", "binary"), ("uniform_grid", "dda"), ("hierarchical_grid", "nested")]
_BOUNDS = Bounds(max_triangles=8192, max_rays=_COUNT, max_lights=8, queue_capacity=65536, grid_entries=65536)


def view() -> views.View:
    return views.procedural_view("robots", "corridor", _SIZE, 1500)


def tracer(names: tuple[str, str], threads: int, bounds: Bounds = _BOUNDS, **more: Any) -> ShadowTracer:
    return ShadowTracer(*names, device="cpu", bounds=bounds, threads=threads, **more)


def states(made: ShadowTracer, seen: views.View, depth: np.ndarray | None = None) -> np.ndarray:
    """States of all lights, twice: kernels are loaded in one thread the first time."""
    made.scene.put("mesh", seen.vertices, seen.triangles)
    image = seen.depth if depth is None else depth
    frames = [made.trace(image, seen.camera, list(seen.lights), bias=seen.bias) for _ in range(2)]
    first, second = (np.stack([frame.state(name) for name in frame.names]) for frame in frames)
    assert np.array_equal(first, second)
    return second


@pytest.mark.wide
@pytest.mark.parametrize("names", [*_VARIANTS, *_WALKERS], ids="/".join)
@pytest.mark.parametrize("threads", [2, 3])
def test_every_number_of_threads_gives_the_same_bits(names: tuple[str, str], threads: int) -> None:
    seen = view()
    if names[0] == "brute_force":
        seen = replace(seen, triangles=seen.triangles[::10])
    made = tracer(names, threads)
    assert made.threads == len(probe.bands(made)) == threads and len(probe.bands(tracer(names, 1))) == 1
    found = states(made, seen)
    assert np.array_equal(found, states(tracer(names, 1), seen))
    assert all(part.samples.count > 0 for part in probe.bands(made))
    assert sum(part.samples.count for part in probe.bands(made)) == _COUNT


@pytest.mark.wide
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_shares_divide_what_is_made_on_demand(threads: int) -> None:
    """Whoever makes it, it is the same; and everything that any band asked for is there."""
    seen = view()
    made, one = tracer(("light_grid", "packed"), threads), tracer(("light_grid", "packed"), 1)
    for step in range(3):
        moved = replace(seen, vertices=seen.vertices + 0.01 * step)
        assert np.array_equal(states(made, moved), states(one, moved))
    for part in probe.bands(made):
        asked = probe_accelerators.clusters(part.pipeline)
        assert len(asked) and (np.diff(asked) > 0).all()


@pytest.mark.wide
@pytest.mark.parametrize("kept", ["top", "bottom", "middle", "none", "one"])
def test_measurements_in_one_place(kept: str) -> None:
    """Bands have equal numbers of measurements, as far as there is room: five eighths of all pixels at most."""
    seen = view()
    depth = np.zeros_like(seen.depth)
    rows = {"top": slice(0, 40), "bottom": slice(-40, None), "middle": slice(100, 140), "none": slice(0, 0)}
    if kept == "one":
        depth[97, 31] = seen.depth[97, 31]
    else:
        depth[rows[kept]] = seen.depth[rows[kept]]
    made = tracer(("light_grid", "packed"), 2)
    assert np.array_equal(states(made, seen, depth), states(tracer(("light_grid", "packed"), 1), seen, depth))
    assert max(part.samples.count for part in probe.bands(made)) <= math.ceil(0.625 * _COUNT)


@pytest.mark.wide
@pytest.mark.parametrize(("count", "used"), [(51200, 1), (40960, 1), (40958, 2), (32768, 2)])
def test_samples_that_one_share_would_be_enough_for_if_it_had_room(count: int, used: int) -> None:
    """25,600 are too few for two threads; a band has room for five eighths of ``max_rays``."""
    seen = view()
    made, one = (tracer(("light_grid", "packed"), n, replace(_BOUNDS, max_rays=count)) for n in (2, 1))
    depth, camera = seen.depth[:160, :160], replace(seen.camera, width=160, height=160)
    points = np.random.default_rng(3).uniform(-2.0, 2.0, (25600, 3))
    for each in (made, one):
        each.scene.put("mesh", seen.vertices, seen.triangles)
    frames = [
        each.trace(np.ascontiguousarray(depth), camera, list(seen.lights), bias=seen.bias) for each in (made, one)
    ]
    for name in frames[0].names:
        assert np.array_equal(frames[0].state(name), frames[1].state(name))
        light = next(light for light in seen.lights if light.name == name)
        assert np.array_equal(made.occluded(points, light), one.occluded(points, light))
    assert sum(part.samples.count > 0 for part in probe.bands(made)) == used


@pytest.mark.parametrize("shape", [(251, 257), (64, 1021), (1021, 64), (1, 65536), (65535, 1)])
def test_images_that_do_not_divide(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    seen = view()
    camera = replace(
        seen.camera, height=shape[0], width=shape[1], cx=shape[1] / 2, cy=shape[0] / 2, fx=shape[1], fy=shape[0]
    )
    depth = rng.uniform(500, 9000, shape).astype(np.uint16)
    other = replace(seen, camera=camera, depth=depth)
    bounds = replace(_BOUNDS, max_rays=shape[0] * shape[1])
    both = [states(tracer(("light_grid", "packed"), threads, bounds), other) for threads in (1, 3)]
    assert np.array_equal(*both)


@pytest.mark.wide
@pytest.mark.parametrize("names", _VARIANTS[:2], ids="/".join)
def test_small_lists_of_every_share(names: tuple[str, str]) -> None:
    seen = view()
    made = tracer(names, 2, replace(_BOUNDS, queue_capacity=1, grid_entries=77))
    assert [part.samples.bounds.grid_entries for part in probe.bands(made)] == [38, 38]
    assert np.array_equal(states(made, seen), states(tracer(names, 1), seen))


def test_points_spheres_and_culling() -> None:
    seen, rng = view(), np.random.default_rng(6)
    lights = [
        SphereLight("bulb", seen.lights[0].position, 0.3, samples=5),
        PointLight("lamp", seen.lights[0].position),
        SpotLight("spot", seen.lights[0].position, (0.1, 0.2, -1.0), 0.9),
    ]
    points = rng.uniform(-5.0, 5.0, (_COUNT, 3))
    points[::1000] = np.nan
    found = []
    for threads in (1, 2):
        made = tracer(("light_grid", "packed"), threads, front_face_culling=True)
        made.scene.put("mesh", seen.vertices, seen.triangles)
        frame = made.trace(seen.depth, seen.camera, lights, bias=Bias(0.01, 0.001))
        found.append((frame.bits(), frame.mask("bulb"), made.states_at(points, lights, 0.01)))
        assert frame.counters["rays"] > 0 and list(frame.stages)[0] == "upload" and "trace" in frame.stages
    for one, two in zip(*found, strict=True):
        assert np.array_equal(one, two)


def test_a_static_light_sets_nothing_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    # Room for the records of all lights.
    seen, made = view(), tracer(("light_grid", "packed"), 2, replace(_BOUNDS, max_triangles=65536))
    states(made, seen)

    calls: list[int] = []
    monkeypatch.setattr(seen_triangles, "prepare", lambda *_: calls.append(1))
    states_again = made.trace(seen.depth, seen.camera, list(seen.lights), bias=seen.bias)
    assert not calls and states_again.counters["triangles"] == len(seen.triangles)


@pytest.mark.wide
def test_pipelines_change_and_verify_works_beside_bands() -> None:
    seen, made = view(), tracer(("light_grid", "packed"), 2)
    expected = states(made, seen)
    assert made.verify(seen.depth, seen.camera, list(seen.lights), bias=seen.bias) == 0
    for names, count in (
        (("light_grid", "spherical"), 1),
        (("mesh_bvh", "refit"), 2),
        (("cone_hierarchy", "linear"), 2),
        (("light_grid", "packed"), 2),
    ):
        made.select(*names)
        assert len(probe.bands(made)) == count
        assert np.array_equal(states(made, seen), expected)
    assert made.verify(seen.depth, seen.camera, list(seen.lights), bias=seen.bias) == 0


def test_few_samples_take_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    made = tracer(("light_grid", "packed"), 2)
    monkeypatch.setattr(Workers, "run", lambda *_: pytest.fail("threads for a handful of samples"))
    seen = view()
    small = replace(seen, depth=seen.depth[:64, :64].copy(), camera=replace(seen.camera, width=64, height=64))
    assert np.array_equal(states(made, small), states(tracer(("light_grid", "packed"), 1), small))


@pytest.mark.wide
def test_both_shares_really_run_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each waits for the other in the middle of its work."""
    seen, made = view(), tracer(("light_grid", "packed"), 2)
    expected = states(made, seen)
    meeting = threading.Barrier(2, timeout=20.0)
    project = band.Band.project

    def met(self: band.Band, *arguments: Any) -> None:
        project(self, *arguments)
        meeting.wait()

    monkeypatch.setattr(band.Band, "project", met)
    frame = made.trace(seen.depth, seen.camera, list(seen.lights), bias=seen.bias)
    assert np.array_equal(np.stack([frame.state(name) for name in frame.names]), expected)


_BUNDLES = [("mesh_bvh", "refit"), ("bvh", "sah"), ("bvh", "threaded")]
_LAMPS: list[Any] = [
    PointLight("hard", (0.5, 0.5, 1.0)),
    SphereLight("more than bits", (0.25, -1.0, 0.5), 0.25, samples=70),
    RectangleLight("panel", (0.25, -1.0, 3.0), (0.5, 0.0, 0.0), (0.0, 0.0, 1.0), samples=33, ignore=["ball"]),
    SunDisc("sun", (0.25, 1.0, 0.5), samples=9),
]


def _small(names: tuple[str, str], threads: int, monkeypatch: pytest.MonkeyPatch) -> ShadowTracer:
    """Bands of a few samples."""
    for module in (bands, frame):
        monkeypatch.setattr(module, "LEAST", 64)
    made = tracer(names, threads, Bounds(max_triangles=2000, max_rays=1600, max_lights=4))
    made.scene.put("ball", *geometry.icosphere(1, 0.6, (0.0, 0.0, 2.0)))
    made.scene.put("soup", *geometry.soup(np.random.default_rng(2), 200, 0.4, 2.5))
    return made


@pytest.mark.wide
@pytest.mark.slow
@pytest.mark.parametrize("names", _BUNDLES, ids="/".join)
def test_masks_by_any_number_of_threads(names: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Images of several sizes and points, one band or all; bundles as the pilot says, or rays; a scene that moves, that
    is empty, and that is there again."""
    monkeypatch.setattr(area_lights, "PILOT", 8)
    made = [_small(names, threads, monkeypatch) for threads in (2, 3, 8)]
    alone = _small(("light_grid", "packed"), 1, monkeypatch)
    assert [len(probe.bands(each)) for each in made] == [2, 3, 8]
    rng = np.random.default_rng(12)
    for step, rows in enumerate((30, 30, 40, 3, 36, 30)):
        monkeypatch.setattr(area_lights, "ray_cost", (lambda *_: 1e9, lambda *_: 1e9, lambda *_: 0.0)[step % 3])
        camera, bias = Camera(40, rows, 35.0, 36.0, 19.25, 14.75), Bias(0.01 * (step % 2))
        depth, points = rng.uniform(2.0, 4.5, (rows, 40)).astype(np.float32), rng.uniform(-2, 4, (1 + 150 * step, 3))
        depth[: rows // 3] = np.nan
        lamps, moved = _LAMPS[step % 2 :], geometry.icosphere(1, 0.6, (0.1 * step, 0.0, 2.0))
        found = []
        for each in (alone, *made):
            if step == 3:
                each.scene.clear()
            else:
                each.scene.put("ball", *moved)
            seen = each.trace(depth, camera, lamps, bias)
            found.append([seen.visibility(lamp.name) for lamp in lamps] + [each.visibility(points, lamps, 0.01)])
        for others in found[1:]:
            for mine, other in zip(found[0], others, strict=True):
                np.testing.assert_array_equal(mine, other, err_msg=f"{step}")


@pytest.mark.wide
def test_masks_of_both_bands_are_asked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each waits for the other; not in the first frame, in which kernels are loaded."""
    made, depth = _small(("mesh_bvh", "refit"), 2, monkeypatch), np.full((30, 40), 3.5, np.float32)
    camera, lamp = Camera(40, 30, 35.0, 36.0, 19.25, 14.75), _LAMPS[2]
    threads: list[str] = []
    meeting = threading.Barrier(2, timeout=20.0)
    see = band.Band.see

    def met(*arguments: Any) -> Any:
        threads.append(threading.current_thread().name)
        if len(threads) > 2:
            meeting.wait()
        return see(*arguments)

    monkeypatch.setattr(band.Band, "see", met)
    first, second = (made.trace(depth, camera, [lamp]).light_bits(lamp.name) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert len(set(threads[:2])) == 1 and len(threads) == 4 and len(set(threads[2:])) == 2


def test_memory_is_shared_not_doubled() -> None:
    one, two = (tracer(("light_grid", "packed"), threads, Bounds()) for threads in (1, 2))
    # Each has room for a quarter more rays than its part.
    assert two.device_bytes < 1.15 * one.device_bytes


@pytest.mark.parametrize("value", [0, -1, 65, 1.5, True, "2"])
def test_bad_numbers_of_threads(value: Any) -> None:
    with pytest.raises(ValueError, match="threads: expected an integer from 1 to 64, or None"):
        ShadowTracer(device="cpu", bounds=_BOUNDS, threads=value)


def test_workers() -> None:
    workers, seen = Workers(3), []
    workers.run([lambda: seen.append(threading.current_thread().name)])
    assert seen == [threading.current_thread().name], "a single job takes no thread"
    done = [threading.Event() for _ in range(3)]
    workers.run([event.set for event in done])
    assert all(event.is_set() for event in done)
    assert 1 <= available_cores() <= MOST


@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_a_job_raises_comes_out_after_all_have_ended(which: int) -> None:
    workers, ended, begun = Workers(3), [], threading.Barrier(3)

    def job(number: int) -> None:
        begun.wait()
        ended.append(number)
        if number == which:
            raise RuntimeError(f"job {number}")

    with pytest.raises(RuntimeError, match=f"job {which}"):
        workers.run([lambda number=number: job(number) for number in range(3)])
    assert sorted(ended) == [0, 1, 2]
