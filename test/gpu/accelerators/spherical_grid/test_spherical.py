# SPDX-License-Identifier: Apache-2.0
"""The spherical light grid: no tile lacks a triangle that hides one of its rays, wherever poles and seam are; work
items as Algorithm 1 has them; depth cells, entries and recordings change nothing but the work."""

from __future__ import annotations

from typing import Any

import bundles
import crowds
import geometry
import numpy as np
import probe
import probe_accelerators
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight, State

wp = pytest.importorskip("warp")

from shadow_tracer.gpu.accelerators import admission  # noqa: E402
from shadow_tracer.gpu.accelerators.spherical_grid import rays as spherical_rays  # noqa: E402
from shadow_tracer.gpu.accelerators.spherical_grid import spherical  # noqa: E402
from shadow_tracer.gpu.exact import decision, light_frame  # noqa: E402

_LAMP = PointLight("lamp", (0.0, 0.0, 0.0))
_LIGHTS: dict[str, Any] = {
    "inside": _LAMP,
    "beside": PointLight("beside", (0.3, -4.0, 1.0)),
    "far": PointLight("far", (3e4, -2e4, 4e4)),
    "sun": DirectionalLight("sun", (-0.3, 0.4, 0.8)),
}


def _tracer(device: str, graphs: bool | None = False, bounds: dict[str, int] | None = None, **settings: Any) -> Any:
    """A tracer with a spherical grid of the given settings."""
    limits = {
        "max_triangles": 3000,
        "max_rays": 8000,
        "max_lights": 4,
        "queue_capacity": 300_000,
        "grid_entries": 300_000,
    }
    tracer = ShadowTracer("light_grid", "spherical", device, Bounds(**{**limits, **(bounds or {})}), graphs=graphs)
    (only,) = probe.bands(tracer)
    only.pipeline = spherical.SphericalGrid("spherical", only.context, **settings)
    return tracer


def _grid_of(tracer: Any) -> spherical.SphericalGrid:
    grid: spherical.SphericalGrid = probe.pipeline(tracer)
    return grid


# --- coverage ---


@wp.kernel(enable_backward=False)
def decide_all(
    light: wp.array(dtype=light_frame.LightFrame),
    samples: wp.array(dtype=wp.vec4d),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    hidden: wp.array2d(dtype=wp.uint8),
):
    i, t = wp.tid()
    c = triangles[t]
    answer = decision.decide(samples[i], light[0].light, vertices[c[0]], vertices[c[1]], vertices[c[2]])
    hidden[i, t] = wp.uint8(answer & 1)


@wp.kernel(enable_backward=False)
def cells_of_rays(
    grid: wp.array(dtype=spherical_rays.Grid),
    order: wp.array(dtype=int),
    polar: wp.array(dtype=wp.vec3),
    cells: wp.array(dtype=int),
):
    i = wp.tid()
    cells[i] = spherical_rays.cell_of(grid[0], polar[order[i]][2])


def _exactly_hidden(tracer: Any, count: int) -> np.ndarray:
    """(samples, triangles) bool: every exact decision there is."""
    context = probe.context(tracer)
    frame, scene = context.samples, context.scene
    hidden = wp.zeros((count, scene.triangle_count), dtype=wp.uint8, device=tracer.device)
    inputs = [frame.light_frame_of[0], frame.positions, scene.vertices, scene.triangles, hidden]
    wp.launch(decide_all, dim=hidden.shape, inputs=inputs, device=tracer.device)
    return hidden.numpy().astype(bool)


def _covered(tracer: Any, triangles: int, rays: int) -> tuple[np.ndarray, np.ndarray]:
    """(R,) rays in the grid, and (R, triangles) bool: which triangles are in their tile, in a cell up to their own."""
    grid = _grid_of(tracer)
    device = tracer.device
    info = grid.rays.tiles.grid.numpy()[0]
    present = int(grid.rays.items.numpy()[grid.rays.counts.numpy()[0]]) if grid.rays.counts.numpy()[0] else 0
    order, tiles = grid.rays.order.numpy()[:present], grid.rays.keys.numpy()[:present]
    cells = wp.zeros(rays, dtype=int, device=device)
    wp.launch(
        cells_of_rays,
        dim=present,
        inputs=[grid.rays.tiles.grid, grid.rays.order, grid.rays.polar, cells],
        device=device,
    )
    # the first cell of each tile that holds a triangle
    first = np.full((int(info["columns"] * info["rows"]), triangles), 1 << 20)
    begins = grid.lists.begins.numpy()
    keys, values = grid.lists.keys.numpy()[: begins[len(first)]], grid.lists.values.numpy()[: begins[len(first)]]
    tile, cell = np.divmod(keys, info["cells"])
    np.minimum.at(first, (tile, values), cell)
    assert len(np.unique(tile * np.int64(triangles) + values)) == len(keys), "a triangle twice in a tile"
    return order, first[tiles] <= cells.numpy()[:present, None]


def _axes(tracer: Any, light: Any) -> np.ndarray:
    """(3, 3): the azimuth starts at the third row and turns to the first; the second points to a pole."""
    frame = light_frame.make_light_frame(light, probe.anchor(tracer))
    return np.stack([np.array(frame.r), np.array(frame.s), -np.array(frame.f)])


def _check_coverage(tracer: Any, light: Any, points: np.ndarray, mesh: geometry.Geometry) -> int:
    """Returns how many pairs of a sample and a triangle that hides it there were."""
    tracer.scene.put("mesh", *mesh)
    answers = tracer.occluded(points, light)
    hidden = _exactly_hidden(tracer, len(points))
    rays, covered = _covered(tracer, len(mesh[1]), len(points))
    lacking = np.argwhere(hidden[rays] & ~covered)
    assert not len(lacking), (
        f"{len(lacking)} pairs lack an entry, first: {points[rays[lacking[0, 0]]]}, {lacking[0, 1]}"
    )
    group = probe_accelerators.admission_groups(_grid_of(tracer)).numpy()[: len(points)]
    assert (np.sort(rays) == np.flatnonzero(group == int(admission.IN_TREE))).all()
    np.testing.assert_array_equal(answers[rays], hidden[rays].any(axis=1))
    return int(hidden[rays].sum())


def _ways(rng: np.random.Generator, axes: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Directions: exactly along the poles, on the seam, a hair beside both, at corners and edges of the triangles, and
    anywhere."""
    poles = np.concatenate([axes[1:2], -axes[1:2]])
    turn = rng.uniform(-1.5, 1.5, (150, 1))
    seam = -np.cos(turn) * axes[2] + np.sin(turn) * axes[1]
    forward = np.cos(turn) * axes[2] + np.sin(turn) * axes[1]
    special = np.concatenate([np.repeat(poles, 50, axis=0), seam, forward, crowds.cube_directions()])
    a, b = corners[:, 0], corners[:, 1]
    return np.concatenate(
        [
            special,
            crowds.hairs_beside(rng, special, 1200),
            corners.reshape(-1, 3),
            a + rng.random((len(a), 1)) * (b - a),
            np.concatenate([corners.mean(axis=1)] * 3) + rng.normal(size=(3 * len(a), 3)) * 1e-3,
            geometry.directions(rng, 800),
        ]
    )


def _triangles(rng: np.random.Generator, axes: np.ndarray) -> np.ndarray:
    """(T, 3, 3) corners seen from the light: around poles and on the seam, through and around the light, slivers,
    behind each other, small and large."""

    def turned(local: np.ndarray) -> np.ndarray:
        out: np.ndarray = local @ axes
        return out

    shapes = []
    for side in (-1.0, 1.0):
        for width in (1e-6, 1e-3, 0.3, 3.0, 100.0):
            # around a pole, with an edge through it, with a corner exactly on it
            ring = np.array([(1.0, 0.0), (-0.5, 0.9), (-0.5, -0.8)]) * width
            around = np.array([(x, side, z) for x, z in ring])
            shapes += [turned(around), turned(around - [ring[:2].mean(axis=0)[0], 0.0, ring[:2].mean(axis=0)[1]])]
            shapes += [turned(around - [ring[0, 0], 0.0, ring[0, 1]])]
    for width in (1e-6, 1e-2, 0.5, 5.0):
        # across the seam, with a corner on it, with an edge in it
        across = np.array([(width, 0.1, -1.0), (-width, 0.2, -1.0), (0.0, 0.1 + width, -1.2)])
        shapes += [turned(across), turned(across * [0.0, 1.0, 1.0] + [[0, 0, 0], [width, 0, 0], [0, 0, 0]])]
    flat = np.array([(4.0, 0.0, 1.0), (-3.0, 0.0, 4.0), (-1.0, 0.0, -5.0)])
    for off in (0.0, 1e-15, 1e-7, -1e-7, 1e-4, 0.05, -0.05):
        # around the light, nearly through it, in planes of all kinds; then with a corner or an edge near it
        shapes += [turned(flat + [0.0, off, 0.0]), turned(np.roll(flat + [0.0, off, 0.0], 1, axis=1))]
        shapes += [turned(flat + [-4.0, off, -1.0]), turned(flat + [-0.5, off, -2.5])]
        shapes += [(flat + [0.0, off, 0.0]) @ geometry.rotation(rng)]
    shapes = [np.asarray(s) for s in shapes]
    soups = [
        geometry.soup(rng, 40, 0.15, 1.0),
        geometry.soup(rng, 40, 5.0, 1.0),
        geometry.slivers(rng, 30),
        geometry.slivers(rng, 10, 300.0),
        bundles.straddling(rng, axes[1], 0.1, 10),
        bundles.straddling(rng, -axes[2], 0.1, 10),
    ]
    return np.concatenate([np.stack(shapes), *(v[t] for v, t in soups)])


@pytest.mark.parametrize("tiles", [1, 4, 40])
@pytest.mark.parametrize("name", _LIGHTS)
def test_no_tile_lacks_a_triangle(any_device: str, name: str, tiles: int) -> None:
    rng = np.random.default_rng([460, len(name), tiles])
    light = _LIGHTS[name]
    tracer = _tracer(any_device, rays_per_tile=tiles)
    limits = np.array([(x, y, z) for x in (-9.0, 9.0) for y in (-9.0, 9.0) for z in (-9.0, 9.0)])
    tracer.occluded(limits, light)  # fixes the frame
    axes = _axes(tracer, light)
    near = name in ("inside", "beside")
    origin = light.position if near else np.zeros(3)
    corners = _triangles(rng, axes)
    ways = _ways(rng, axes, corners)
    # a sample behind each of these places, or a hair before it
    behind = rng.choice([-1e-3, 0.0, 0.5, 3.0], (len(ways), 1))
    places = origin + ways * (1.0 + behind) if near else ways + behind * axes[2]
    points = np.concatenate([limits, np.clip(places, -9.0, 9.0)])
    mesh = (corners + origin).reshape(-1, 3), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    pairs = _check_coverage(tracer, light, points, mesh)
    assert pairs > 5_000
    np.testing.assert_array_equal(axes, _axes(tracer, light))
    if name == "inside":
        grid = _grid_of(tracer).rays.tiles.grid.numpy()[0]
        turns = grid["columns"] / grid["columns_per_radian"], grid["rows"] / grid["rows_per_radian"]
        np.testing.assert_allclose(turns, (2.0 * np.pi, np.pi), rtol=1e-5)


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("way", ["pole", "seam", "forward", "anywhere"])
def test_no_tile_lacks_a_triangle_of_a_narrow_bundle(any_device: str, way: str, width: float) -> None:
    """Tiles as narrow as the roundings of angles, and wider; edges go through the bundle, corners into it."""
    rng = np.random.default_rng([461, len(way)])
    tracer = _tracer(any_device)
    tracer.occluded(np.array([(-4.0, -4.0, -4.0), (4.0, 4.0, 4.0)]), _LAMP)
    axes = _axes(tracer, _LAMP)
    axis = {"pole": axes[1], "seam": -axes[2], "forward": axes[2], "anywhere": np.array([0.6, -0.3, 0.7])}[way]
    points = bundles.grid(axis, width, 24, 2.5)
    small = geometry.soup(rng, 60, 4.0 * width, 10.0 * width)
    corners = geometry.soup(rng, 1, 0.0, 0.0)[0] + bundles.grid(axis, 3.0 * width, 6, 1.2).repeat(3, axis=0)[:, None]
    corners = corners[:, 0].reshape(-1, 3, 3) + rng.normal(size=(36, 3, 3)) * [[[0.0], [0.5], [0.5]]]
    mesh = geometry.join(
        [
            bundles.edges_across(rng, axis, 10.0 * width, 40),
            bundles.straddling(rng, axis, 10.0 * width, 20),
            (small[0] + axis, small[1]),
            geometry.split(corners.reshape(-1, 3), np.arange(108).reshape(-1, 3)),
        ]
    )
    points = np.concatenate([[(-4.0, -4.0, -4.0), (4.0, 4.0, 4.0)], points])
    # the two that keep the frame are left out of the grid: they would make its tiles wide
    tracer.scene.put("mesh", *mesh)
    narrow = SpotLight("lamp", (0.0, 0.0, 0.0), axis, max(40.0 * width, 1e-3))
    assert _check_coverage(tracer, narrow, points, mesh) > 100
    np.testing.assert_array_equal(axes, _axes(tracer, _LAMP))


def test_no_tile_lacks_a_triangle_that_nearly_touches_the_light(any_device: str) -> None:
    """Float32 does not know on which side of the light such a corner is."""
    rng = np.random.default_rng(468)
    light = PointLight("lamp", (30.0, -400.0, 100.0))
    points = rng.uniform(-3.0, 3.0, (3000, 3))
    points[:2] = [-3.0, -3.0, -3.0], [3.0, 3.0, 3.0]
    corners = rng.uniform(-3.0, 3.0, (80, 3, 3))
    corners[40:] *= 20.0
    corners[:, 0] = light.position + np.spacing(400.0) * rng.integers(-1, 2, (80, 3))
    points, corners[:, 1:] = points + [0.1, 0.2, 0.3], corners[:, 1:] + [0.1, 0.2, 0.3]
    tracer = _tracer(any_device)
    mesh = corners.reshape(-1, 3), np.arange(240, dtype=np.int32).reshape(-1, 3)
    assert _check_coverage(tracer, light, points, mesh) > 1000


def test_a_directional_grid_is_as_regular_as_a_near_one(any_device: str) -> None:
    """Far lights' directions are stretched: their rays do not crowd in one tile."""
    points = np.random.default_rng(462).uniform(-2.0, 2.0, (4000, 3))
    largest = {}
    for name, light in _LIGHTS.items():
        tracer = _tracer(any_device, rays_per_tile=16)
        tracer.scene.put("mesh", *geometry.square(1, -1.0, 1.0))
        tracer.occluded(points, light)
        rays = _grid_of(tracer).rays
        items, tiles = rays.counts.numpy()
        largest[name] = np.bincount(rays.keys.numpy()[: rays.items.numpy()[items]]).max()
        assert tiles > 0.4 * rays.tile_count
    assert max(largest.values()) < 150, largest


# --- work items ---


@pytest.mark.parametrize("threshold", [1, 2, 7, 32, 10**6])
@pytest.mark.parametrize("name", _LIGHTS)
def test_work_items(any_device: str, name: str, threshold: int) -> None:
    """Algorithm 1: R rays of a tile make ceil(R / r) work items, none of two tiles, none of more than r rays."""
    rng = np.random.default_rng(463)
    points = np.concatenate([rng.normal(size=(1500, 3)) * 3.0, rng.normal(size=(500, 3)) * 0.01 + [1.0, 2.0, 1.0]])
    tracer = _tracer(any_device, threshold=threshold, rays_per_tile=8)
    tracer.scene.put("mesh", *geometry.soup(rng, 200, 0.4, 2.0))
    hidden = tracer.occluded(points, _LIGHTS[name])
    np.testing.assert_array_equal(hidden, _exactly_hidden(tracer, len(points)).any(axis=1))
    rays = _grid_of(tracer).rays
    items, tiles = (int(n) for n in rays.counts.numpy())
    bounds, keys = rays.items.numpy()[: items + 1], rays.keys.numpy()
    assert bounds[0] == 0 and bounds[-1] == 2000 and items <= rays.item_bound
    assert (np.sort(rays.order.numpy()[:2000]) == np.arange(2000)).all() and (np.diff(keys[:2000]) >= 0).all()
    sizes = np.diff(bounds)
    assert (sizes >= 1).all() and (sizes <= threshold).all()
    assert all(len(np.unique(keys[a:b])) == 1 for a, b in zip(bounds, bounds[1:], strict=False))
    in_tile = np.bincount(keys[:2000])
    assert items == (-(-in_tile // threshold)).sum() and tiles == (in_tile > 0).sum()
    assert probe.counters(tracer)["splits"] == items - tiles
    assert 0.05 < hidden.mean() < 0.95


# --- depth cells, spots ---


def test_depth_cells_save_tests(any_device: str) -> None:
    """In a room full of small things, rays of one tile start at all distances."""
    rng = np.random.default_rng(464)
    vertices, triangles = geometry.museum(rng, 2500)
    points = rng.uniform((-4.9, -3.9, -1.9), (4.9, 3.9, 1.9), (8000, 3))
    light = PointLight("lamp", (0.2, 0.1, 1.0))
    answers, tests = [], []
    for cells in (1, 2, 8, 64):
        tracer = _tracer(any_device, cells=cells, rays_per_tile=64)
        tracer.scene.put("room", vertices, triangles)
        answers.append(tracer.occluded(points, light))
        counters = probe.counters(tracer)
        tests.append(counters["leaf_tests"] / counters["rays"])
    assert all(np.array_equal(answer, answers[0]) for answer in answers) and 0.1 < answers[0].mean() < 0.9
    assert tests[0] > 1.05 * tests[1] and tests[1] > 1.05 * tests[2], tests
    brute = ShadowTracer("brute_force", None, any_device, tracer.bounds)
    brute.scene.put("room", vertices, triangles)
    np.testing.assert_array_equal(brute.occluded(points[::8], light), answers[0][::8])


def test_the_grid_is_clamped_to_a_spot(any_device: str) -> None:
    """The same number of tiles for a smaller and smaller part of all directions."""
    tracer = _tracer(any_device, rays_per_tile=16)
    rng = np.random.default_rng(465)
    tracer.scene.put("mesh", *geometry.soup(rng, 2000, 0.05, 3.0))
    points = geometry.directions(rng, 8000) * 3.0
    points[:2] = [-3.0, -3.0, -3.0], [3.0, 3.0, 3.0]
    tracer.occluded(points, _LAMP)
    forward = _axes(tracer, _LAMP)[2]
    sizes, entries = [], []
    for angle in (3.0, 1.0, 0.3, 0.1):
        tracer.occluded(points, SpotLight("spot", (0.0, 0.0, 0.0), forward, angle))
        grid = _grid_of(tracer).rays.tiles.grid.numpy()[0]
        sizes.append(1.0 / (grid["columns_per_radian"] * grid["rows_per_radian"]))
        entries.append(probe.counters(tracer)["entries"])
        assert 300 < grid["columns"] * grid["rows"] <= 500
    assert all(b < 0.6 * a for a, b in zip(sizes, sizes[1:], strict=False)), sizes
    assert all(b < 0.6 * a for a, b in zip(entries, entries[1:], strict=False)), entries


# --- what a recording needs ---


def _camera(step: int) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = 0.02 * step, -0.01 * step, 0.0
    return Camera(24, 20, 20.0, 20.0, 11.5, 9.5, pose)


def _frames(tracer: Any) -> list[np.ndarray]:
    """States of eight frames in which camera, depth, lights and mesh move, stay and appear."""
    rng = np.random.default_rng(466)
    vertices, triangles = geometry.icosphere(2, 1.0, (0.0, 0.0, 3.0))
    tracer.scene.put("ball", vertices, triangles)
    states = []
    for step in range(8):
        depth = rng.uniform(2.0, 6.0, (20, 24)).astype(np.float32)
        depth[rng.random(depth.shape) < 0.1] = np.nan
        lights = [PointLight("lamp", (0.4 * step - 1.0, -2.0, 0.5 * step)), DirectionalLight("sun", (0.1, 0.2, 1.0))]
        if step != 5:
            tracer.scene.deform("ball", vertices * (1.0 + 0.02 * step))
        if step == 4:
            tracer.scene.put("roof", *geometry.square(1, -1.5, 0.7, (0.0, 3.0)))
        frame = tracer.trace(depth, _camera(step), lights, bias=0.01)
        states += [frame.state(light.name) for light in lights]
    return states


@pytest.mark.parametrize("entries", [100, 2000])
def test_recorded_frames_are_equal(any_device: str, entries: int) -> None:
    """Launches of fixed size, launched one by one and replayed, also where the list of entries is too short."""
    bounds = {"grid_entries": entries}
    expected = _frames(_tracer(any_device, bounds=bounds))
    fixed = _frames(_tracer(any_device, bounds=bounds, fixed=True))
    recording = _tracer(any_device, graphs=True, bounds=bounds, fixed=True)
    for states in (fixed, _frames(recording)):
        assert all(np.array_equal(a, b) for a, b in zip(expected, states, strict=True))
    assert probe.recordings(recording) >= 1
    assert any((state == State.SHADOWED).any() for state in expected)


def test_fixed_size_and_few_entries(any_device: str) -> None:
    """A list that is longer than needed by any number of places, and shorter: the same bits, the same tests."""
    rng = np.random.default_rng(467)
    mesh, points = geometry.soup(rng, 30, 0.6, 1.0), rng.uniform(-3.0, 3.0, (300, 3))
    roomy = _tracer(any_device, fixed=True)
    roomy.scene.put("mesh", *mesh)
    expected = roomy.occluded(points, _LAMP)
    counters = probe.counters(roomy)
    total = counters["entries"]
    assert 0.1 < expected.mean() < 0.9 and total > 60
    for entries in (1, total // 2, total - 1, total, total + 1):
        tracer = _tracer(any_device, fixed=True, bounds={"grid_entries": entries})
        tracer.scene.put("mesh", *mesh)
        np.testing.assert_array_equal(tracer.occluded(points, _LAMP), expected)
        again = probe.counters(tracer)
        assert (again["entries"], again["largest_tile"]) == (total, counters["largest_tile"])
        if entries >= total:
            assert again["leaf_tests"] == counters["leaf_tests"] and again["passes"] == 1
        else:
            # the first part, and then all of them
            assert again["passes"] == 1 - (-total // entries)
