# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer.cones: FREE and BLOCKED are never wrong, and PARTLY is what the documentation says."""

from __future__ import annotations

from typing import Any

import cones
import data
import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, DirectionalLight, Outcome, PointLight, ShadowTracer

_FREE, _PARTLY, _BLOCKED = Outcome.FREE, Outcome.PARTLY, Outcome.BLOCKED
_SMALL = {"max_triangles": 4000, "max_rays": 1 << 15, "max_lights": 2, "queue_capacity": 4000, "grid_entries": 20_000}
_UP = np.array([0.0, 0.0, 2.0])


def _tracer(device: str, pipeline: str = "bvh", **bounds: int) -> ShadowTracer:
    return ShadowTracer(pipeline, device=device, bounds=Bounds(**{**_SMALL, **bounds}), threads=1)


def _compare_with_rays(tracer: Any, apices: np.ndarray, low: Any, high: Any, count: int, rng: Any) -> np.ndarray:
    """How often each outcome was found; of cones with rays that say otherwise there must be none."""
    found = np.zeros(3, np.int64)
    for apex in apices:
        ends, share = cones.some(rng, count, low, high)
        far = np.sqrt(((ends - apex) ** 2).sum(axis=1))
        ends, radius = ends[far > 1e-6], (share * far)[far > 1e-6]
        outcomes = tracer.cones(apex, ends, radius)
        hidden = tracer.occluded(cones.ends_of_rays(np.broadcast_to(apex, ends.shape), ends, radius, 64), _at(apex))
        assert not hidden[outcomes == _FREE].any()
        assert hidden[outcomes == _BLOCKED].all()
        found += np.bincount(outcomes, minlength=3)
    return found


def _at(apex: Any) -> PointLight:
    return PointLight("apex", apex)


_MESHES = {
    "ball": geometry.icosphere(2),
    "soup": geometry.soup(np.random.default_rng(500), 150, 0.5, 1.0),
    "apart": geometry.split(*geometry.icosphere(2)),
    "integers": geometry.integer_soup(np.random.default_rng(501), 80),
    "slivers": geometry.join([geometry.box((-1, -1, -1), (1, 1, 1)), geometry.spiky_sphere()]),
}


@probe.in_both_forms
@pytest.mark.parametrize("name", list(_MESHES))
def test_never_wrong_beside_rays(any_device: str, kernel_form: str, name: str) -> None:
    rng, tracer, (vertices, triangles) = np.random.default_rng(502), _tracer(any_device), _MESHES[name]
    tracer.scene.put(name, vertices, triangles)
    low, high = vertices.min(axis=0) - 0.5, vertices.max(axis=0) + 0.5
    found = _compare_with_rays(tracer, rng.uniform(low, high, (8, 3)), low, high, 60, rng)
    assert found.min() > 5  # all three occur


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sibenik", "sponza_dabrovic", "stanford_bunny", "conference"])
def test_never_wrong_on_real_meshes(any_device: str, name: str) -> None:
    rng, (vertices, triangles) = np.random.default_rng(503), data.mesh(name)
    tracer = _tracer(any_device, max_triangles=len(triangles), max_rays=1 << 17)
    tracer.scene.put(name, vertices, triangles)
    low, high = np.min(vertices, axis=0), np.max(vertices, axis=0)
    found = _compare_with_rays(tracer, rng.uniform(low, high, (25, 3)), low, high, 1000, rng)
    assert found.sum() > 24_000 and found.min() > 100


@probe.in_both_forms
def test_free_is_what_convex_minimisation_says(any_device: str, kernel_form: str) -> None:
    rng = np.random.default_rng(504)
    vertices, triangles = geometry.soup(rng, 12, 0.6, 1.0)
    tracer = _tracer(any_device)
    tracer.scene.put("soup", vertices, triangles)
    apices = rng.uniform(-1, 1, (60, 3))
    ends, slopes = cones.some(rng, 60, -1, 1)
    slopes[::3] *= 4.0
    outcomes = tracer.cones(apices, ends, half_angle=np.arctan(slopes))
    pairs = [np.repeat(each, 12, axis=0) for each in (apices, ends, slopes)]
    least = cones.excess(np.tile(vertices[triangles], (60, 1, 1)), *pairs).reshape(60, 12).min(axis=1)
    assert not (outcomes[least < -1e-9] == _FREE).any()
    assert (outcomes[least > 1e-9] == _FREE).all()
    assert 10 < (least > 0).sum() < 50


def test_rims_that_only_just_meet(any_device: str) -> None:
    """A triangle's corner, edge and face a few roundings inside of a cone and outside: never FREE inside, and not less
    than it once the gap is more than what is left in doubt."""
    tracer = _tracer(any_device)
    for far in (0.0, 1e3, 1e6):
        shift = np.array([far, -far, 0.5 * far])
        for triangle in ([(0, 1, 1), (-1, 3, 1), (1, 3, 1)], [(-2, 1, 1), (2, 1, 1), (0, 4, 1)]):
            for gap, outcome in ((-1e-7, _PARTLY), (0.0, _PARTLY), (1e-7, _FREE)):
                corners = np.array(triangle, np.float64) + [0, gap, 0] + shift
                tracer.scene.put("one", corners, [(0, 1, 2)])
                assert tracer.cones(shift, shift + _UP, 2.0) == outcome, (far, gap)


@pytest.mark.parametrize("pipeline", ["light_grid", "brute_force", "bvh"])
def test_half_angle_zero_is_the_ray(any_device: str, pipeline: str) -> None:
    rng, tracer = np.random.default_rng(505), _tracer(any_device, pipeline)
    tracer.scene.put("integers", *geometry.integer_soup(rng, 60))
    points = rng.integers(-4, 5, (400, 3)).astype(np.float64)
    apex = np.array([5.0, 1.0, -4.0])
    hidden = tracer.occluded(points, _at(apex))
    assert 50 < hidden.sum() < 390
    for how in ({"radius": 0.0}, {"half_angle": 0.0}):
        outcomes = tracer.cones(points, apex, **how)
        np.testing.assert_array_equal(outcomes, np.where(hidden, _BLOCKED, _FREE))
    far = tracer.cones(points * 1e8, apex, 0.0)  # from beyond the reach of the tree
    np.testing.assert_array_equal(far == _BLOCKED, tracer.occluded(points * 1e8, _at(apex)))


def _plate(cuts: int = 1, height: float = 1.0) -> geometry.Geometry:
    """A square of 2 * cuts^2 triangles across the z axis, whose inner edges are off the axis."""
    steps = np.linspace(-2.0, 2.1, cuts + 1)
    x, y = np.meshgrid(steps, steps)
    vertices = np.stack([x.reshape(-1), y.reshape(-1), np.full(x.size, height)], axis=1)
    row, column = np.mgrid[:cuts, :cuts].reshape(2, -1)
    a = row * (cuts + 1) + column
    triangles = np.concatenate([np.stack([a, a + 1, a + cuts + 2], 1), np.stack([a, a + cuts + 2, a + cuts + 1], 1)])
    return vertices, triangles.astype(np.int32)


@probe.in_both_forms
def test_one_triangle_and_a_sheet_hide(any_device: str, kernel_form: str) -> None:
    tracer = _tracer(any_device)
    tracer.scene.put("one", [(-9, -9, 1), (9, -9, 1), (0, 9, 1)], [(0, 1, 2)])
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _BLOCKED
    assert tracer.cones((0, 0, 0), _UP, 20.0) == _PARTLY
    for cuts in (1, 2, 5, 20):
        tracer.scene.put("one", *_plate(cuts))
        assert tracer.cones((0, 0, 0), _UP, 0.9) == _BLOCKED, cuts
        assert tracer.cones((0, 0, 0), _UP, 5.0) == _PARTLY  # beyond its rim
        assert tracer.cones((0, 0, 0), (0, 0, 0.9), 0.9) == _FREE
        assert tracer.cones((0, 0, 0), (0, 0, 1.0), 0.9) == _PARTLY  # it lies in the end
    tracer.scene.put("one", *geometry.split(*_plate(5)))
    assert tracer.cones((0, 0, 0), _UP, 0.9) == _BLOCKED
    tracer.scene.put("behind", *_plate(1, 5.0))
    assert tracer.cones((0, 0, 0), _UP, 0.9) == _BLOCKED
    tracer.scene.put("rubble", *geometry.soup(np.random.default_rng(506), 40, 0.2, 0.2))
    tracer.scene.put("wall", [(-9, -9, 1.5), (9, -9, 1.5), (0, 9, 1.5)], [(0, 1, 2)])
    assert tracer.cones((0, 0, -1), _UP, 0.5) == _BLOCKED  # one triangle behind rubble


def test_what_does_not_join_edge_to_edge_hides_nothing(any_device: str) -> None:
    tracer = _tracer(any_device)
    plate = [(-3, -3, 1), (3, -3, 1), (3, 0.01, 1), (-3, 0.01, 1), (3, 3, 1), (-3, 3, 1), (0.02, 0.01, 1)]
    joined = [(0, 1, 2), (0, 2, 3), (3, 2, 4), (3, 4, 5)]
    cut = [*joined[:2], (3, 6, 5), (6, 4, 5), (6, 2, 4)]  # a T-junction: one edge there, two here
    fin = [*plate, (0, 0, 5)]
    tracer.scene.put("plate", plate, joined)
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _BLOCKED
    tracer.scene.put("plate", plate, cut)
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _PARTLY
    tracer.scene.put("plate", plate, [*cut, (3, 2, 6)])  # closed by a triangle without area
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _PARTLY
    tracer.scene.put("plate", fin, [*joined, (3, 2, 7)])  # three triangles at an edge
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _PARTLY
    tracer.scene.put("plate", plate, joined[:2])
    tracer.scene.put("rest", plate, joined[2:])  # another mesh
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _PARTLY
    tracer.scene.remove("rest")
    folded = [(-3, 0, 1), (3, 0, 1), (0, 9, 1.5), (0, 9, 1.0)]
    tracer.scene.put("plate", folded, [(0, 1, 2), (0, 3, 1)])  # both on one side of their edge
    assert tracer.cones((0, 0.1, 0), _UP, 0.5) == _PARTLY


def test_edges_that_come_apart(any_device: str) -> None:
    """Neighbours are found once for the triangles of a mesh; that they still are is looked at each time."""
    tracer = _tracer(any_device)
    vertices, triangles = geometry.split(*_plate(4))
    torn, middle = vertices.copy(), np.abs(vertices[triangles].mean(axis=1)[:, :2]).sum(axis=1).argmin()
    torn[triangles[middle]] += [0.0, 0.0, 1e-9]
    for shown, outcome in ((vertices, _BLOCKED), (torn, _PARTLY), (vertices, _BLOCKED)):
        if "plate" in tracer.scene:
            tracer.scene.deform("plate", shown)
        else:
            tracer.scene.put("plate", shown, triangles)
        assert tracer.cones((0, 0, 0), _UP, 1.5) == outcome
    tracer.scene.put("plate", torn, triangles)
    assert tracer.cones((0, 0, 0), _UP, 1.5) == _PARTLY
    turned = vertices.copy()
    turned[triangles[middle]] = [(0, 0, 1), (0, 1, 1), (np.nan, 0, 0)]
    tracer.scene.put("plate", vertices, triangles)
    tracer.scene.deform("plate", turned, nonfinite="skip")
    assert tracer.cones((0, 0, 0), _UP, 1.5) == _PARTLY


def test_apex_on_a_triangle_is_partly(any_device: str) -> None:
    tracer = _tracer(any_device)
    tracer.scene.put("floor", [(-9, -9, 0), (9, -9, 0), (0, 9, 0)], [(0, 1, 2)])
    assert tracer.cones((0, 0, 0), _UP, 0.1) == _PARTLY
    assert tracer.cones((0, 0, 1e-6), _UP, 0.1) == _FREE
    assert tracer.cones((0, 0, 0), _UP, 0.0) == _FREE  # the ray begins behind its start
    assert tracer.cones((0, 0, -1e-6), _UP, 0.1) == _BLOCKED
    assert tracer.cones((9, -9, 0), (20, -20, 0), 0.1) == _PARTLY  # a corner
    assert tracer.cones((20, 20, 0), (30, 30, 0), 0.1) == _FREE  # in its plane, beside it


def test_nothing_there_and_what_casts_nothing(any_device: str) -> None:
    tracer = _tracer(any_device)
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _FREE
    outcome, number, distance = tracer.cones((0, 0, 0), _UP, 0.5, first=True)
    assert (outcome, number, distance) == (_FREE, -1, np.inf)
    line = [(0, 0, 1), (0.125, 0.125, 1.125), (0.25, 0.25, 1.25), (np.nan, 0, 1), (1, 0, 1), (0, 1, 1)]
    tracer.scene.put("nothing", line[:3] + [(9, 9, 9), (9, 8, 9), (8, 9, 9)], [(0, 1, 2), (0, 0, 1), (3, 4, 5)])
    tracer.scene.deform("nothing", line, nonfinite="skip")
    assert tracer.cones((0, 0, 0), _UP, 0.5) == _FREE
    assert tracer.cone_hits((0, 0, 0), _UP, 0.5, 4)[0].max() == -1
    assert tracer.cones(np.zeros((0, 3)), _UP, 0.5).shape == (0,)


def test_a_budget_only_leaves_in_doubt(any_device: str) -> None:
    rng, tracer = np.random.default_rng(507), _tracer(any_device)
    tracer.scene.put("soup", *_MESHES["soup"])
    ends, share = cones.some(rng, 300, -1.5, 1.5)
    whole = tracer.cones((0.1, 0.2, 1.4), ends, half_angle=np.arctan(share))
    known = []
    for budget in (1, 3, 4, 6, 10**12):
        some = tracer.cones((0.1, 0.2, 1.4), ends, half_angle=np.arctan(share), budget=budget)
        assert ((some == whole) | (some == _PARTLY)).all()
        known.append(int((some != _PARTLY).sum()))
    assert known == sorted(known) and known[0] < known[2] < known[-1]
    assert (some == whole).all()


def test_a_hint_changes_no_answer(any_device: str) -> None:
    """Alone, in any order, behind cones that something else hides: the same, with a budget as well."""
    rng, tracer = np.random.default_rng(511), _tracer(any_device)
    tracer.scene.put("ball", *_MESHES["ball"])
    tracer.scene.put("plate", *_plate(6, 1.25))
    ends, share = cones.some(rng, 200, -1.5, 1.5)
    apices = np.array([0.1, 0.2, -1.4]) + 0.01 * rng.normal(size=(200, 3))
    for budget in (None, 2, 6):
        whole = tracer.cones(apices, ends, half_angle=np.arctan(share), budget=budget)
        order = rng.permutation(200)
        mixed = tracer.cones(apices[order], ends[order], half_angle=np.arctan(share)[order], budget=budget)
        np.testing.assert_array_equal(mixed, whole[order])
        alone = [
            tracer.cones(a, e, half_angle=np.arctan(s), budget=budget)
            for a, e, s in zip(apices, ends, share, strict=True)
        ]
        np.testing.assert_array_equal(alone, whole)
        assert budget or (np.bincount(whole, minlength=3) > 10).all()


def test_a_budget_is_spent_without_hints(any_device: str) -> None:
    """Cones through rubble need more than those beside it, though one triangle behind hides both."""
    tracer = _tracer(any_device)
    tracer.scene.put("rubble", *geometry.soup(np.random.default_rng(512), 300, 0.2, 0.3))
    tracer.scene.put("wall", [(-9, -9, 1.5), (9, -9, 1.5), (0, 9, 1.5)], [(0, 1, 2)])
    apices = np.tile([(-3.0, -2.0, 0.0), (0.0, 0.0, -1.0)], (8, 1))
    ends, unlike = apices + [0.0, 0.0, 4.0], 0
    for budget in range(1, 40):
        found = tracer.cones(apices, ends, 0.2, budget=budget)
        for place in (0, 1):
            alone = tracer.cones(apices[place], ends[place], 0.2, budget=budget)
            assert (found[place::2] == alone).all(), budget
        unlike += found[0] == _BLOCKED and found[1] == _PARTLY
    assert unlike > 1 and (tracer.cones(apices, ends, 0.2) == _BLOCKED).all()


@pytest.mark.parametrize("pipeline", ["bvh", "kd_tree", "brute_force"])
def test_a_budget_counts_the_triangles_of_a_sheet(any_device: str, pipeline: str) -> None:
    """A wall of many small triangles hides a cone as a sheet, all of which must be looked at that the cone meets."""
    tracer = _tracer(any_device, pipeline)
    vertices, triangles = _plate(28, 1.0)
    tracer.scene.put("wall", vertices, triangles)
    axis = np.array([0.013, 0.021, 2.0])
    met = np.linalg.norm((vertices[triangles].mean(axis=1) - axis / 2.0)[:, :2], axis=1) < 0.4
    needed = next(budget for budget in range(1, 3000) if tracer.cones((0, 0, 0), axis, 0.8, budget=budget) == _BLOCKED)
    assert 20 < met.sum() <= needed


def test_a_sheet_hides_whatever_else_is_there(any_device: str) -> None:
    """Before it or behind it; of up to 128 triangles."""
    tracer = _tracer(any_device)
    tracer.scene.put("plate", *_plate(8))
    tracer.scene.put("rubble", *geometry.soup(np.random.default_rng(506), 40, 0.2, 0.2))
    assert tracer.cones((0, 0, -1), _UP, 1.2) == _BLOCKED
    tracer.scene.move("rubble", geometry.pose_of(np.eye(3), (0.0, 0.0, 1.5)))
    assert tracer.cones((0, 0, -1), _UP, 1.2) == _BLOCKED
    tracer.scene.clear()
    vertices, triangles = _plate(40)
    tracer.scene.put("plate", vertices, triangles)
    assert tracer.cones((0, 0, 0), _UP, 0.3) == _BLOCKED
    assert tracer.cones((0, 0, 0), _UP, 1.5) == _PARTLY
    around = np.hypot(*vertices[triangles].mean(axis=1)[:, :2].T)
    assert (around < 0.15).sum() > 10 and (around < 0.7).sum() > 128


def test_shapes_lengths_and_radii(any_device: str) -> None:
    tracer = _tracer(any_device)
    tracer.scene.put("plate", *_plate(3))
    apices = np.zeros((4, 1, 3))
    assert tracer.cones(apices, np.broadcast_to(_UP, (5, 3)), 0.5).shape == (4, 5)
    assert tracer.cones((0, 0, 0), (0, 0, 7), half_angle=0.1, length=0.9) == _FREE
    assert tracer.cones((0, 0, 0), (0, 0, 0.1), half_angle=0.1, length=[0.9, 2.0]).tolist() == [_FREE, _BLOCKED]
    radii = tracer.cones((0, 0, 0), _UP, [0.5, 5.0])
    assert radii.dtype == np.uint8 and radii.tolist() == [_BLOCKED, _PARTLY]
    assert tracer.cones((0, 0, 0), _UP, 1e-320) == _BLOCKED


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"apex": (0, 0)}, "apex: expected real numbers of shape"),
        ({"apex": (0, np.nan, 0)}, "apex: expected finite"),
        ({"target": (0, np.inf, 0)}, "target: expected finite"),
        ({"target": (0, 0, 0)}, "target: expected points other"),
        ({"target": "up"}, "target: expected real"),
        ({"radius": None}, "radius: expected either"),
        ({"half_angle": 0.1}, "radius: expected either"),
        ({"radius": -1.0}, "radius: expected numbers from 0"),
        ({"radius": 100.0}, "radius: expected at most 14.1 times"),
        ({"radius": None, "half_angle": 1.6}, "half_angle: expected numbers from 0 to 1.5"),
        ({"radius": None, "half_angle": np.nan}, "half_angle: expected"),
        ({"length": 0.0}, "length: expected numbers"),
        ({"apex": (1e20, 0, 0), "length": 1e-3}, "length: expected one that float64 can add"),
        ({"radius": [1.0, 2.0], "length": [1.0, 2.0, 3.0]}, "apex: expected leading shapes"),
        ({"first": 1}, "first: expected True"),
        ({"budget": 0}, "budget: expected"),
        ({"budget": 2.5}, "budget: expected"),
    ],
)
def test_what_is_refused(any_device: str, arguments: dict[str, Any], message: str) -> None:
    tracer = _tracer(any_device)
    with pytest.raises(ValueError, match=message):
        tracer.cones(**{"apex": (0, 0, 0), "target": _UP, "radius": 0.5, **arguments})


def test_culling_and_what_lights_ignore_play_no_part(any_device: str) -> None:
    tracer = _tracer(any_device)
    tracer.scene.put("plate", *_plate(3))
    tracer.front_face_culling = True
    sun = DirectionalLight("sun", (0, 0, -1), ignore=["plate"])
    for _ in range(2):
        assert not tracer.occluded([(0.0, 0.0, 0.0)], sun).any()
        assert tracer.cones((0, 0, 0), _UP, 0.5) == tracer.cones(_UP, (0, 0, 0), 0.5) == _BLOCKED


def test_memory_is_counted_and_made_when_first_asked_for(any_device: str) -> None:
    tracer = _tracer(any_device, "light_grid")
    tracer.scene.put("plate", *_plate(3))
    before = tracer.device_bytes
    tracer.occluded([(0.0, 0.0, 0.0)], DirectionalLight("sun", (0, 0, -1)))
    assert tracer.device_bytes == before
    tracer.cones((0, 0, 0), _UP, 0.5)
    after = tracer.device_bytes
    assert after > before
    tracer.cones(np.zeros((70_000, 3)), _UP, 0.5)
    assert tracer.device_bytes == after


@probe.in_both_forms
@pytest.mark.parametrize("pipeline", ["light_grid", "bvh"])
def test_a_moving_scene_is_as_a_fresh_one(any_device: str, kernel_form: str, pipeline: str) -> None:
    """Refitted or built, whatever came before: outcomes and lists are those of a tracer that saw nothing else."""
    rng, tracer = np.random.default_rng(508), _tracer(any_device, pipeline)
    ball, apices = geometry.icosphere(2), rng.uniform(-2, 2, (40, 3))
    ends, share = cones.some(rng, 40, -2, 2)

    def answers(asked: ShadowTracer) -> list[np.ndarray]:
        return [asked.cones(apices, ends, half_angle=np.arctan(share)), *asked.cone_hits(apices, ends, 0.2, 6)]

    for step in range(7):
        if step == 3:
            tracer.scene.remove("ball")
        else:
            moved = ball[0] * (1.0 + 0.2 * step) + 0.1 * np.sin(step + 5.0 * ball[0][:, ::-1])
            if step in (0, 4):
                tracer.scene.put("ball", moved, ball[1])
            else:
                tracer.scene.deform("ball", moved)
        if step in (0, 5):
            tracer.scene.put("plate", *_plate(2 + step, 1.25))
        if step % 2:
            tracer.scene.move("plate", geometry.pose_of(np.eye(3), (0.0, 0.1 * step, 0.0)))
            tracer.occluded(apices, _at((3.0, 3.0, 3.0)))
        fresh = _tracer(any_device, "bvh")
        for mesh in tracer.scene:
            fresh.scene.put(mesh.name, mesh.vertices, mesh.triangles, mesh.pose)
        for mine, theirs in zip(answers(tracer), answers(fresh), strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_a_sheet_that_reaches_through_the_end(any_device: str) -> None:
    tracer = _tracer(any_device)
    vertices, triangles = _plate(6)
    slanted = vertices + [0.0, 0.0, 0.75] + np.outer(vertices[:, 0], [0.0, 0.0, 0.5])
    tracer.scene.put("plate", slanted, triangles)
    assert tracer.cones((0, 0, 0), _UP, 0.3) == _BLOCKED
    assert tracer.cones((0, 0, 0), _UP, 0.9) == _PARTLY  # hidden on one side alone
    corners = np.array([(-90.0, -90.0, 2.0), (90.0, -90.0, 2.0), (0.0, 90.0, 2.0)])
    for height, outcome in ((-0.5, _BLOCKED), (-0.2, _PARTLY), (0.0, _PARTLY), (0.2, _PARTLY), (0.5, _FREE)):
        one = corners + np.outer(corners[:, 0], [0.0, 0.0, 0.5]) + [0.0, 0.0, height]
        tracer.scene.put("plate", one, [(0, 1, 2)])
        assert tracer.cones((0, 0, 0), _UP, 0.6) == outcome, height
