# SPDX-License-Identifier: Apache-2.0
"""Points that somebody asks about: the answers are those of the library, and what is not known is not called lit."""

from __future__ import annotations

import array
import math
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from harness import Rig, plate, wall
from node_world import UNKNOWN, cloud_msg, library, library_with_plate
from sensor_msgs.msg import PointCloud2, PointField
from tf_double import Buffer, module, transform

from shadow_tracer import DirectionalLight, PointLight, ShadowTracer, SphereLight, SpotLight, State
from shadow_tracer.ros.diagnostics import ERROR, PROCESSING, TRANSFORMS, WARN
from shadow_tracer.ros.wire.clouds import cloud_normals
from shadow_tracer.ros.wire.messages import rigid

LIGHTS = {
    "mask.unknown_value": UNKNOWN,
    "bias.constant": 0.01,
    "light_names": ["lamp", "spot", "off", "sky"],
    "lights.lamp.range": 2.5,
    "lights.spot.type": "spot",
    "lights.spot.outer_angle": 0.3,
    "lights.off.enabled": False,
    "lights.sky.type": "directional",
}


def lights(pose: np.ndarray | None = None) -> dict[int, Any]:
    """The enabled ones by their bits, in a frame."""
    to_world = np.eye(4) if pose is None else pose
    where, way = to_world[:3, :3] @ (0.5, -0.5, 0.0) + to_world[:3, 3], to_world[:3, :3] @ (0.0, 0.0, 1.0)
    spot = SpotLight("spot", where, way, 0.3)
    return {0: PointLight("lamp", where, range=2.5), 1: spot, 3: DirectionalLight("sky", way)}


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig(LIGHTS) as made:
        made.send_mesh(*plate())
        yield made


@pytest.fixture(scope="module")
def tracer() -> ShadowTracer:
    return library_with_plate()


def points_of(count: int, seed: int = 1) -> np.ndarray:
    """Behind and around the plate, exact in float32."""
    points = np.random.default_rng(seed).uniform((-1.0, -1.0, 0.2), (1.0, 1.0, 2.5), (count, 3))
    return points.astype(np.float32).astype(np.float64)


def answer(msg: PointCloud2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3), lights (N,) and known (N,) of an answer."""
    assert [field.name for field in msg.fields] == ["x", "y", "z", "lights", "known"] and msg.point_step == 20
    rows = np.frombuffer(msg.data, np.dtype("f4, f4, f4, u4, u1, 3V1", align=False))
    return np.stack([rows[f"f{k}"] for k in range(3)], 1), rows["f3"], rows["f4"].astype(bool)


def expected(tracer: ShadowTracer, points: np.ndarray, pose: np.ndarray | None = None) -> np.ndarray:
    """(N,) bits as the library says, by its function for single points."""
    bits = np.zeros(len(points), np.uint32)
    for place, light in lights(pose).items():
        reached = tracer.states_at(points, [light], bias=0.01)[0] == State.LIT
        hidden = tracer.occluded(points, light, bias=0.01)
        assert not (reached & hidden).any()
        bits |= reached.astype(np.uint32) << np.uint32(place)
    return bits


def test_answers_are_those_of_the_library(rig: Rig, tracer: ShadowTracer) -> None:
    for number, (kind, height) in enumerate((("f4", 1), ("f8", 1), ("f4", 4))):
        points = points_of(400, number)
        query = cloud_msg(points, stamp=5_000_000_007, kind=kind, height=height)
        msg = rig.ask(query)
        assert msg.header == query.header and (msg.height, msg.width) == (height, 400 // height)
        found, bits, known = answer(msg)
        np.testing.assert_array_equal(found, points)
        assert known.all()
        np.testing.assert_array_equal(bits, expected(tracer, points))
        assert len(set(bits.tolist())) > 4  # all sorts of them, or this compares nothing
    rig.until(lambda: rig.value(PROCESSING, "queries answered") == "3")
    assert rig.value(PROCESSING, "queries of which nothing is known") == "0"


def cloud_with_normals(
    points: np.ndarray, normals: np.ndarray, frame: str = "camera", count: int = 3, stamp: int = 0
) -> PointCloud2:
    """A query of float64 points with the first ``count`` coordinates of their normals."""
    msg = cloud_msg(points, stamp, frame, "f8")
    rows = np.zeros((len(points), 8))
    rows[:, :3], rows[:, 4:7] = points, normals
    msg.point_step, msg.row_step = 64, 64 * len(points)
    for k, axis in enumerate("xyz"[:count]):
        msg.fields.append(PointField(name=f"normal_{axis}", offset=32 + 8 * k, datatype=PointField.FLOAT64, count=1))
    msg.data = array.array("B", rows.tobytes())
    return msg


def test_points_with_normals_start_off_their_surface(rig: Rig, tracer: ShadowTracer) -> None:
    """Points 0.05 mm behind the plate are in shadow until they are moved to the side that faces the light, whatever the
    lengths of their normals; one that is none moves nothing."""
    points = points_of(200)
    points[:, :2] *= 0.15
    points[:, 2] = 1.00005
    normals = np.tile([0.0, 0.0, -1.0], (200, 1))
    normals[:50] *= 7.0
    normals[150:170], normals[170:] = 0.0, np.nan
    for factor in (0.0, 2.0):
        assert rig.set(bias__constant=3e-5, bias__normal=factor) == ""
        found, bits, known = answer(rig.ask(cloud_with_normals(points, normals)))
        moved = points + factor * 3e-5 * np.where(np.isfinite(normals), np.sign(normals), 0.0)
        lit = tracer.states_at(moved, [lights()[0]], bias=3e-5)[0] == State.LIT
        np.testing.assert_array_equal((bits & 1).astype(bool), lit)
        np.testing.assert_array_equal(found, points.astype(np.float32))  # as asked
        assert known.all() and lit[:150].all() == (factor > 0.0) and not lit[150:].any()
    assert not (answer(rig.ask(cloud_msg(points, kind="f8")))[1] & 1).any()  # without normals


def test_half_a_normal_is_refused(rig: Rig) -> None:
    points = points_of(4)
    rig.publisher(PointCloud2, "query").publish(cloud_with_normals(points, points, count=2))
    rig.wait_status(PROCESSING, WARN, "query refused, fields: expected one each of normal_x, normal_y and normal_z")
    assert answer(rig.ask(cloud_with_normals(points, points)))[2].all()


def test_queries_and_frames_do_not_disturb_each_other(rig: Rig, tracer: ShadowTracer) -> None:
    before = rig.trace(wall())
    points = points_of(300)
    bits = expected(tracer, points)
    for _ in range(3):
        np.testing.assert_array_equal(answer(rig.ask(cloud_msg(points)))[1], bits)
        np.testing.assert_array_equal(rig.trace(wall()), before)
    rig.send_mesh(*plate(x=0.3))  # a query sees what came before it
    other = library()
    other.scene.put("mesh", *plate(x=0.3))
    np.testing.assert_array_equal(answer(rig.ask(cloud_msg(points)))[1], expected(other, points))
    assert not np.array_equal(rig.trace(wall()), before)


def test_points_that_are_not_finite_are_not_known(rig: Rig, tracer: ShadowTracer) -> None:
    points = points_of(50)
    points[3, 1], points[10] = math.nan, math.inf
    finite = np.isfinite(points).all(axis=1)
    found, bits, known = answer(rig.ask(cloud_msg(points, kind="f8")))
    np.testing.assert_array_equal(known, finite)
    assert bits[~finite].tolist() == [0, 0]
    np.testing.assert_array_equal(bits[finite], expected(tracer, points[finite]))
    np.testing.assert_array_equal(found, points)
    nothing = rig.ask(cloud_msg(np.full((4, 3), np.nan)))
    assert not answer(nothing)[2].any()
    huge = np.array([[0.0, 0.0, 1e60], [0.3, 0.3, 0.5]])  # finite, but farther than any scene
    _, bits, known = answer(rig.ask(cloud_msg(huge, kind="f8")))
    assert known[1] and not (bits[0] and known[0])
    assert len(answer(rig.ask(cloud_msg(np.empty((0, 3)))))[1]) == 0
    assert rig.value(PROCESSING, "faults") == "0"


def test_a_query_is_in_the_frame_of_its_header(monkeypatch: pytest.MonkeyPatch, tracer: ShadowTracer) -> None:
    double, made = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    with Rig({**LIGHTS, "fixed_frame": "map", "tf_timeout": 5.0}) as rig:
        buffer: Buffer = made[0]
        rig.send_mesh(*plate())
        turn, stamp = (0.0, 0.0, 0.6, 0.8), rig.stamp
        points = points_of(200)
        answers = rig.collect(PointCloud2, "shadow_tracer/query/visibility")
        publisher = rig.publisher(PointCloud2, "query")
        publisher.publish(cloud_msg(points, stamp, "robot"))
        publisher.publish(cloud_msg(points, stamp, "map"))  # behind one that waits; answers keep the order
        rig.until(lambda: len(rig.core.queries) == 2)
        assert not answers
        for when, x in ((stamp - 1000, 0.1), (stamp + 1000, 0.3)):
            buffer.set_transform(transform("map", "robot", when, (x, -0.1, 0.2), turn), "test")
        rig.until(lambda: len(answers) == 2, 4.0)
        pose = rigid((0.2, -0.1, 0.2), turn, "robot")
        in_map = points @ pose[:3, :3].T + pose[:3, 3]
        assert [msg.header.frame_id for msg in answers] == ["robot", "map"]
        np.testing.assert_array_equal(answer(answers[0])[1], expected(tracer, in_map))
        np.testing.assert_array_equal(answer(answers[1])[1], expected(tracer, points))
        np.testing.assert_array_equal(answer(answers[0])[0], points.astype(np.float32))  # in its own frame

        assert rig.set(bias__normal=2.0) == ""
        points = points_of(2000)
        normals = points_of(2000, seed=2)
        query = cloud_with_normals(points, normals, "robot", stamp=stamp)
        _, bits, _ = answer(rig.ask(query))
        in_map = points @ pose[:3, :3].T + pose[:3, 3]
        moved = in_map + 2.0 * 0.01 * (cloud_normals(query) @ pose[:3, :3].T)  # they turn with the frame
        np.testing.assert_array_equal(bits, expected(tracer, moved))
        assert (bits != expected(tracer, in_map)).sum() > 20


def test_a_frame_that_is_missing_makes_the_answer_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    double, _ = module()
    monkeypatch.setitem(sys.modules, "tf2_ros", double)
    with Rig({**LIGHTS, "fixed_frame": "map", "tf_timeout": 0.0}) as rig:
        _, bits, known = answer(rig.ask(cloud_msg(points_of(10), rig.stamp, "nowhere")))
        assert not known.any() and not bits.any()  # before there was an image, too
        status = rig.wait_status(TRANSFORMS, WARN, "nowhere")
        assert "header.frame_id of query" in status.message
        rig.wait_status(PROCESSING, WARN, "the last query has no answer, see 'transforms'")
        assert answer(rig.ask(cloud_msg(points_of(10), rig.stamp, "map")))[2].all()
        rig.until(lambda: rig.value(PROCESSING, "queries of which nothing is known") == "1")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"light_names": [""]}, "no light is enabled"),
        ({"lights__lamp__frame": "tool", "fixed_frame": "map", "pose_source": "parameter"}, "tool"),
    ],
    ids=["lights", "frame of a light"],
)
def test_what_a_mask_needs_a_query_needs(rig: Rig, change: dict[str, Any], text: str) -> None:
    assert rig.set(**change) == ""
    frame = "map" if "fixed_frame" in change else "camera"
    _, bits, known = answer(rig.ask(cloud_msg(points_of(10), rig.stamp, frame)))
    assert not known.any() and not bits.any()
    rig.until(lambda: any(text in status.message for status in rig.reports[-1].status))


def test_before_the_first_image_no_frame_is_taken_for_the_camera(tracer: ShadowTracer) -> None:
    points, turn = points_of(50), (0.0, 0.0, 0.6, 0.8)
    pose = rigid((0.2, 0.1, 0.0), turn, "camera_pose")
    with Rig({**LIGHTS, "pose_source": "parameter", "camera_pose": [0.2, 0.1, 0.0, *turn]}) as rig:
        rig.send_mesh(*plate())
        np.testing.assert_array_equal(answer(rig.ask(cloud_msg(points, frame="")))[1], expected(tracer, points))
        assert not answer(rig.ask(cloud_msg(points, frame="camera")))[2].any()
        rig.trace(wall())
        _, bits, known = answer(rig.ask(cloud_msg(points, frame="camera")))
        assert known.all()
        np.testing.assert_array_equal(bits, expected(tracer, points @ pose[:3, :3].T + pose[:3, 3]))
        assert not answer(rig.ask(cloud_msg(points, frame="lidar")))[2].any()
        rig.wait_status(TRANSFORMS, ERROR, "header.frame_id of query is 'lidar' but fixed_frame is empty")


def test_a_stale_mesh_makes_the_answer_unknown() -> None:
    with Rig({**LIGHTS, "mesh.max_age": 5.0, "use_sim_time": True}) as rig:
        rig.publish_clock(100.0)
        rig.until(lambda: rig.core.now_ns() == 100 * 10**9)
        rig.send_mesh(*plate())
        assert answer(rig.ask(cloud_msg(points_of(10))))[2].all()
        rig.publish_clock(106.0)
        rig.until(lambda: rig.core.now_ns() == 106 * 10**9)
        assert not answer(rig.ask(cloud_msg(points_of(10))))[2].any()


def test_queries_that_cannot_be_used_are_refused(rig: Rig) -> None:
    publisher = rig.publisher(PointCloud2, "query")
    answers = rig.collect(PointCloud2, "shadow_tracer/query/visibility")
    without_z = cloud_msg(points_of(4))
    without_z.fields = without_z.fields[:2]
    short = cloud_msg(points_of(4))
    short.data = short.data[:-1]
    most = 128 * 96
    bad = [
        (without_z, "fields: expected one each of x, y and z"),
        (short, "data: 4 x 1 points need 64 bytes, got 63"),
        (cloud_msg(points_of(most + 1)), f"bounds.max_rays: the query has {most + 1} points, the bound is {most}"),
    ]
    for number, (message, text) in enumerate(bad, 1):
        publisher.publish(message)
        rig.until(lambda count=str(number): rig.value(PROCESSING, "queries refused") == count)
        rig.wait_status(PROCESSING, WARN, f"query refused, {text}")
    assert not answers
    assert answer(rig.ask(cloud_msg(points_of(most))))[2].all()  # as many as there is room for


def test_a_query_that_fails_is_unknown_and_does_not_come_again(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise RuntimeError("the driver is gone")

    monkeypatch.setattr(rig.core.host.made, "states_at", broken)
    _, bits, known = answer(rig.ask(cloud_msg(points_of(5))))
    assert not known.any() and not bits.any()
    rig.wait_status(PROCESSING, ERROR, "the query failed: the driver is gone")
    monkeypatch.undo()
    assert answer(rig.ask(cloud_msg(points_of(5))))[2].all()
    rig.until(lambda: rig.value(PROCESSING, "queries answered") == "2")


def test_more_than_can_wait_are_dropped_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the tracer is busy they wait, the last eight of them."""
    import threading

    from shadow_tracer.ros.node import tracer_host

    gate = threading.Event()
    monkeypatch.setattr(tracer_host, "run", lambda *_, **__: gate.wait(60.0) and [])
    with Rig(LIGHTS) as rig:
        rig.core.host.self_test(lambda _outcome: None)
        answers = rig.collect(PointCloud2, "shadow_tracer/query/visibility")
        publisher = rig.publisher(PointCloud2, "query")
        for number in range(11):
            publisher.publish(cloud_msg(points_of(1), number))
        rig.until(lambda: rig.value(PROCESSING, "queries dropped") == "3")
        assert not answers
        gate.set()
        rig.until(lambda: len(answers) == 8)
        assert [msg.header.stamp.nanosec for msg in answers] == list(range(3, 11))


def test_a_sphere_reaches_a_point_if_some_of_it_does(tracer: ShadowTracer) -> None:
    points = points_of(400)
    parameters = {"bias.constant": 0.01, "lights.lamp.type": "sphere", "lights.lamp.radius": 0.2}
    with Rig(parameters) as rig:
        rig.send_mesh(*plate())
        bits = answer(rig.ask(cloud_msg(points)))[1]
    states = tracer.states_at(points, [SphereLight("lamp", (0.5, -0.5, 0.0), 0.2)], bias=0.01)[0]
    np.testing.assert_array_equal(bits, np.isin(states, (State.LIT, State.PENUMBRA)))
    assert (states == State.PENUMBRA).any() and (states == State.SHADOWED).any()


def test_the_surface_of_the_depth_image_casts_on_queries_while_it_is_an_occluder(rig: Rig) -> None:
    behind = np.array([[0.0, 0.1, 2.5]])
    assert rig.set(occluders="depth") == ""
    rig.trace(wall())
    assert answer(rig.ask(cloud_msg(behind)))[1].tolist() == [0]
    assert rig.set(occluders="mesh") == ""
    rig.send_mesh(np.empty((0, 3)), np.empty((0, 3), int))
    assert answer(rig.ask(cloud_msg(behind)))[1].tolist() != [0]
