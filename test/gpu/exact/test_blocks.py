# SPDX-License-Identifier: Apache-2.0
"""The CPU's vectorised stages against their scalar twins, which CUDA runs: the same samples, states and rays bit for
bit, and the same records."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import pytest

wp = pytest.importorskip("warp")

from shadow_tracer import Bounds, DirectionalLight, PointLight, SpotLight  # noqa: E402
from shadow_tracer.gpu.device.devices import pick_device  # noqa: E402
from shadow_tracer.gpu.exact.light_frame import Anchor, make_light_frame  # noqa: E402
from shadow_tracer.gpu.exact.records import BLOCK, FILTER_FACTOR, prepare_triangles  # noqa: E402
from shadow_tracer.gpu.occluders.seen import prepare  # noqa: E402
from shadow_tracer.gpu.occluders.world import SceneBuffers  # noqa: E402
from shadow_tracer.gpu.samples import pixels  # noqa: E402
from shadow_tracer.gpu.samples import rays as projection  # noqa: E402
from shadow_tracer.gpu.samples.pinhole import Pinhole  # noqa: E402
from shadow_tracer.gpu.samples.sample_set import SampleSet  # noqa: E402
from shadow_tracer.scene.checks import LARGEST  # noqa: E402
from shadow_tracer.scene.mesh import Scene  # noqa: E402

pytestmark = pytest.mark.wide

_RAYS = 6000
_TRIANGLES = 3000
_GARBAGE = 77.0


@pytest.fixture(scope="module")
def frame() -> SampleSet:
    return SampleSet(
        Bounds(max_triangles=_TRIANGLES, max_rays=_RAYS, max_lights=1, queue_capacity=1), pick_device("cpu")
    )


def _bits(array: np.ndarray) -> np.ndarray:
    return array.copy().view({4: np.uint32, 8: np.uint64}[array.itemsize])


# Depth image to samples


def _metres(rng: np.random.Generator, count: int) -> np.ndarray:
    depth = rng.uniform(0.3, 9.0, count).astype(np.float32)
    bad = rng.random(count) < 0.3
    special = [0.0, -0.0, -1.0, np.nan, np.inf, -np.inf, 1e-45, 1e-38, 3.4e38, 1e30]
    depth[bad] = rng.choice(np.array(special, np.float32), int(bad.sum()))
    return depth


def _millimetres(rng: np.random.Generator, count: int) -> np.ndarray:
    return (rng.integers(0, 65536, count) * (rng.random(count) < 0.7)).astype(np.uint16)


def _pinhole(rng: np.random.Generator, width: int, focal: float, bias: tuple[float, float]) -> Any:
    pinhole = Pinhole()
    pinhole.width, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy = width, focal, 1.1 * focal, width / 2.1, 3.3
    rows = np.column_stack([geometry.rotation(rng), rng.uniform(-9, 9, 3)])
    if focal == 1e-13:
        # Columns alone reach beyond the largest coordinate, along one axis of the world.
        rows[:, :3] = np.roll(np.eye(3), width % 3, axis=0)
        pinhole.fy = 500.0
    pinhole.row0, pinhole.row1, pinhole.row2 = (wp.vec4d(*row) for row in rows)
    pinhole.bias_constant, pinhole.bias_quadratic = bias
    return pinhole


@pytest.mark.parametrize("tabled", [False, True])
@pytest.mark.parametrize("make", [_metres, _millimetres])
@pytest.mark.parametrize(
    ("width", "count"), [(1, 1), (1, 1500), (7, 21), (64, 3072), (1023, 5115), (1025, 5125), (3000, 6000)]
)
@pytest.mark.parametrize(
    ("focal", "bias"), [(500.0, (0.01, 0.002)), (0.3, (0.0, 0.0)), (1e-13, (1.0, 1e50)), (1e-280, (0.0, 1.0))]
)
def test_samples(
    frame: SampleSet, make: Any, width: int, count: int, focal: float, bias: tuple[float, float], tabled: bool
) -> None:
    rng = np.random.default_rng(width + count)
    depth = make(rng, count)
    pinhole = _pinhole(rng, width, focal, bias)
    pinhole.tabled = tabled
    frame.ray_table.numpy()[:count] = rng.uniform(-2.0, 2.0, (count, 2)).astype(np.float32)
    frame.ray_table.numpy()[:count:7] = np.nan
    metres = depth.dtype == np.float32
    array = frame.depth_metres if metres else frame.depth_millimetres
    array.numpy()[:count] = depth
    frame.positions.fill_(wp.vec4d(_GARBAGE, _GARBAGE, _GARBAGE, _GARBAGE))
    frame.valid.fill_(9)
    frame.set_camera(np.array([pinhole.numpy_value()], Pinhole.numpy_dtype()))
    units = wp.float64(1.0 if metres else 1000.0)
    inputs = [frame.pinhole, frame.ray_table, units, array, frame.positions, frame.valid]
    wp.launch(pixels.unproject, dim=count, inputs=inputs, device="cpu")
    samples, valid = frame.positions.numpy().copy(), frame.valid.numpy().copy()
    frame.positions.fill_(wp.vec4d(_GARBAGE, _GARBAGE, _GARBAGE, _GARBAGE))
    frame.valid.fill_(9)
    frame.set_samples(count, 0)
    pixels.unproject_image(array, frame)
    np.testing.assert_array_equal(frame.valid.numpy(), valid)
    seen = valid == 1
    assert not seen[:count].all() or count < 100
    assert (np.abs(samples[seen][:, :3]) <= LARGEST).all()
    np.testing.assert_array_equal(_bits(frame.positions.numpy())[seen], _bits(samples)[seen])
    assert (frame.positions.numpy()[count:] == _GARBAGE).all(), "written beyond the image"


# Samples to rays

_LIGHTS = {
    "point": PointLight("l", (0.3, 0.2, 2.0)),
    "point_with_range": PointLight("l", (0.3, 0.2, 2.0), range=1.5),
    "point_on_a_sample": PointLight("l", (0.5, 0.5, 0.5)),
    "on_the_grid": PointLight("l", (1.0, 0.0, 2.0)),
    "far": PointLight("l", (3e9, -2e9, 1e9)),
    "huge": PointLight("l", (1e49, -1e49, 1e50)),
    "spot": SpotLight("l", (0.1, 0.2, 2.5), (0.1, 0.0, -1.0), 0.4, range=2.6),
    "wide_spot": SpotLight("l", (0.1, 0.2, 0.5), (0.1, 0.3, -1.0), 2.0),
    "directional": DirectionalLight("l", (0.2, 0.4, -3.0)),
}


def _samples(rng: np.random.Generator, count: int) -> np.ndarray:
    samples = rng.normal(size=(count, 4))
    samples[:, 3] = rng.choice([0.0, 0.01, 0.6, 1.4, 5.0, LARGEST], count)
    samples[rng.random(count) < 0.05, :3] = 0.5
    samples[rng.random(count) < 0.05, :3] = (0.3, 0.2, 0.5)  # exactly at the range of a light
    far = rng.random(count) < 0.05
    samples[far, :3] *= 10.0 ** rng.uniform(3, 49, (int(far.sum()), 1))
    return samples


@pytest.mark.parametrize("light", _LIGHTS)
@pytest.mark.parametrize("count", [1, 255, 256, 257, 5000])
@pytest.mark.parametrize("counted", [False, True])
def test_rays_and_states(frame: SampleSet, light: str, count: int, counted: bool) -> None:
    rng = np.random.default_rng(count)
    samples, valid = frame.positions.numpy(), frame.valid.numpy()
    samples[:count], valid[:count] = _samples(rng, count), rng.random(count) < 0.8
    samples[:count][valid[:count] == 0] = np.nan
    frame.set_samples(count, 0)
    frame_of_light = make_light_frame(_LIGHTS[light], Anchor((0.1, 0.0, -0.1), 2.5))
    frame.set_lights([frame_of_light])
    inputs = [
        frame.light_frame_of[0],
        int(counted),
        frame.positions,
        frame.valid,
        frame.rays,
        frame.states,
        frame.counters,
    ]

    def run(blocks: bool) -> tuple[np.ndarray, np.ndarray, int]:
        frame.rays.fill_(wp.vec4(_GARBAGE, _GARBAGE, _GARBAGE, _GARBAGE))
        frame.states.fill_(9)
        frame.counters.zero_()
        if blocks:
            projection.project(frame, 0, 0, counted)
        else:
            wp.launch(projection.project_samples, dim=count, inputs=inputs, device="cpu")
        return frame.rays.numpy().copy(), frame.states.numpy().copy(), frame.read_counters()["rays"]

    rays, after, traced = run(False)
    block_rays, block_after, block_traced = run(True)
    np.testing.assert_array_equal(block_after, after)
    assert block_traced == traced
    assert (traced > 0) != counted or count == 1
    concerned = (after == 0)[:count]
    there = ~np.isnan(rays[:count, 0])
    np.testing.assert_array_equal(np.isnan(block_rays[:count, 0])[concerned], ~there[concerned])
    np.testing.assert_array_equal(_bits(block_rays)[:count][concerned & there], _bits(rays)[:count][concerned & there])
    assert (block_rays[count:] == _GARBAGE).all(), "written beyond the samples"
    assert np.isnan(block_rays[:count, 0])[~concerned].all(), "a sample that is not traced has a ray"


# Triangles to records


def _random(rng: np.random.Generator) -> geometry.Geometry:
    return geometry.soup(rng, 900, 0.3, 2.0)


def _tiny(rng: np.random.Generator) -> geometry.Geometry:
    return geometry.soup(rng, 300, 1e-9, 2.0)


def _slivers(rng: np.random.Generator) -> geometry.Geometry:
    return geometry.slivers(rng, 300)


def _exact_ties(rng: np.random.Generator) -> geometry.Geometry:
    return geometry.integer_soup(rng, 900)


def _nearly_flat(rng: np.random.Generator) -> geometry.Geometry:
    """Corners on a line up to the last bits, and planes through the light up to the last bits."""
    ends = rng.uniform(-3, 3, (400, 2, 3))
    along = ends[:, 0] + rng.uniform(0, 1, (400, 1)) * (ends[:, 1] - ends[:, 0])
    edge_on = ends[:, 0] + rng.uniform(0, 1, (400, 1)) * (_LIGHTS["point"].position - ends[:, 0])
    corners = np.stack([ends[:, 0], ends[:, 1], np.where(rng.random((400, 1)) < 0.5, along, edge_on)], axis=1)
    return geometry.split(corners.reshape(-1, 3), np.arange(1200).reshape(-1, 3))


def _spread(rng: np.random.Generator) -> geometry.Geometry:
    vertices, triangles = geometry.soup(rng, 900, 0.3, 2.0)
    scale = 10.0 ** rng.uniform(-40, 49, 900)
    return (vertices.reshape(-1, 3, 3) * scale[:, None, None]).reshape(-1, 3), triangles


def _not_finite(rng: np.random.Generator) -> geometry.Geometry:
    vertices, triangles = geometry.soup(rng, 900, 0.3, 2.0)
    bad = rng.random(vertices.shape) < 0.02
    vertices[bad] = rng.choice([np.nan, np.inf, -np.inf], int(bad.sum()))
    axis_aligned = rng.random(900) < 0.3  # zero times infinity
    vertices.reshape(-1, 3, 3)[axis_aligned, :, 0] = 0.25
    return vertices, triangles


_MESHES = (_random, _tiny, _slivers, _exact_ties, _nearly_flat, _spread, _not_finite)


def _prepared(frame: SampleSet, scene: SceneBuffers, light: Any, cull: int, blocks: bool) -> tuple[Any, int, int]:
    frame.set_lights([make_light_frame(light, Anchor((0.1, 0.0, -0.1), 2.5))])
    made = wp.empty((_TRIANGLES, 4), dtype=wp.vec4, device="cpu")
    made.fill_(wp.vec4(_GARBAGE, _GARBAGE, _GARBAGE, _GARBAGE))
    silent = wp.zeros(-(-_TRIANGLES // BLOCK), dtype=wp.vec2i, device="cpu")
    if blocks:
        prepare(frame.light_frame_of[0], scene, made, bool(cull), silent)
    else:
        inputs = [
            0,
            frame.light_frame_of[0],
            FILTER_FACTOR,
            scene.vertices,
            scene.triangles,
            made,
            cull,
            silent,
        ]
        wp.launch(prepare_triangles, dim=scene.triangle_count, inputs=inputs, device="cpu")
    degenerate, culled = silent.numpy().sum(axis=0)
    return made.numpy().copy(), int(degenerate), int(culled)


@pytest.mark.parametrize("make", _MESHES, ids=lambda make: make.__name__.strip("_"))
@pytest.mark.parametrize("light", ["point", "on_the_grid", "far", "huge", "directional"])
@pytest.mark.parametrize("cull", [0, 1])
def test_records(frame: SampleSet, make: Any, light: str, cull: int) -> None:
    vertices, triangles = make(np.random.default_rng(7))
    scene = Scene(frame.bounds)
    scene.put("mesh", vertices, triangles, nonfinite="skip")
    device_scene = SceneBuffers(frame.bounds, frame.device)
    device_scene.sync(scene)
    one, degenerate, culled = _prepared(frame, device_scene, _LIGHTS[light], cull, False)
    other, block_degenerate, block_culled = _prepared(frame, device_scene, _LIGHTS[light], cull, True)
    assert (block_degenerate, block_culled) == (degenerate, culled)
    assert cull or culled == 0
    count = len(triangles)
    assert (other[count:] == _GARBAGE).all(), "written beyond the triangles"
    never = np.zeros((4, 4), np.float32)
    never[3, 3] = 1.0
    nothing = (one[:count] == never).all(axis=(1, 2))
    np.testing.assert_array_equal((other[:count] == never).all(axis=(1, 2)), nothing)
    assert nothing.sum() == degenerate + culled
    np.testing.assert_array_equal(_bits(other), _bits(one))


def test_the_meshes_above_have_what_they_are_for(frame: SampleSet) -> None:
    """Triangles that only the exact sign can judge, of both kinds, and corners that are not finite."""
    counts = {}
    for make in _MESHES:
        scene = Scene(frame.bounds)
        vertices, triangles = make(np.random.default_rng(7))
        scene.put("mesh", vertices, triangles, nonfinite="skip")
        device_scene = SceneBuffers(frame.bounds, frame.device)
        device_scene.sync(scene)
        _, degenerate, culled = _prepared(
            frame, device_scene, _LIGHTS["on_the_grid" if make is _exact_ties else "point"], 1, True
        )
        counts[make.__name__] = (degenerate, culled, len(triangles))
        assert 0 < culled < len(triangles) - degenerate
    assert counts["_random"][0] == 0 and counts["_exact_ties"][0] > 20 and counts["_not_finite"][0] > 50, counts
    vertices, triangles = _nearly_flat(np.random.default_rng(7))
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    rows = np.stack([_LIGHTS["point"].position - a, b - a, c - a], axis=1)
    size = np.prod(np.linalg.norm(rows, axis=2), axis=1)
    assert (np.abs(np.linalg.det(rows)) < 1e-15 * size).sum() > 50, "float64 can judge nearly all of them"
