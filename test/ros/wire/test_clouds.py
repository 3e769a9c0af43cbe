# SPDX-License-Identifier: Apache-2.0
"""Clouds of any layout become points, or are refused with a reason; answers to queries are clouds that others read."""

from __future__ import annotations

import importlib.util
import math
import struct
import subprocess
import sys
import tracemalloc
from array import array
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cloud_double import FLOAT32, FLOAT64, Cloud, changed, cloud, field, some_points

from shadow_tracer import Scene
from shadow_tracer.ros.wire.clouds import cloud_cones, cloud_normals, cloud_points, soup_part, visibility_cloud
from shadow_tracer.ros.wire.parts import Changes, Part, PartError, soup_triangles
from shadow_tracer.ros.world.mesh_store import MeshStore

ENDIAN = pytest.mark.parametrize("big", [False, True], ids=["little", "big"])


# Points.


@ENDIAN
@pytest.mark.parametrize("datatype", [FLOAT32, FLOAT64])
@pytest.mark.parametrize(
    ("offsets", "point_step", "padding"),
    [(None, 0, 0), ((0, 8, 16), 32, 0), ((17, 1, 9), 29, 5), ((16, 8, 0), 24, 3), ((4, 12, 20), 31, 64)],
)
def test_any_layout_is_read(big: bool, datatype: int, offsets: Any, point_step: int, padding: int) -> None:
    points = some_points(15)
    if datatype == FLOAT64:
        points /= 3.0  # values that float32 does not have
    points[3], points[7, 1] = np.nan, np.inf
    for shape in ((15, 3), (3, 5, 3), (15, 1, 3)):
        message = cloud(points.reshape(shape), datatype, big, offsets, point_step, padding)
        found = cloud_points(message)
        np.testing.assert_array_equal(found, points)
        assert found.dtype == np.float64 and found.flags.c_contiguous and found.flags.aligned


def test_coordinates_may_differ_in_type_and_stand_among_other_fields() -> None:
    record = np.dtype(
        {"names": ["i", "z", "x", "y"], "formats": ["<u2", "<f8", "<f4", "<f4"], "offsets": [0, 3, 11, 15]}
    )
    rows = np.zeros(4, record)
    rows["x"], rows["y"], rows["z"] = [1, 2, 3, 4], [5, 6, 7, 8], [0.1, 0.2, 0.3, 0.4]
    message = cloud(some_points(4), point_step=record.itemsize)
    message.fields = [
        field("intensity", 0, 4), field("z", 3, FLOAT64), field("x", 11), field("y", 15), field("rgb", 0, 6, 9)
    ]  # fmt: skip
    message.data = array("B", rows.tobytes())
    np.testing.assert_array_equal(cloud_points(message), np.stack([rows["x"], rows["y"], rows["z"]], axis=1))


def test_the_last_row_needs_no_padding_and_a_single_row_no_row_step() -> None:
    points = some_points(6)
    message = cloud(points.reshape(2, 3, 3), padding=7)
    message.data = message.data[:-7]
    np.testing.assert_array_equal(cloud_points(message), points)
    np.testing.assert_array_equal(cloud_points(changed(cloud(points), row_step=0)), points)
    np.testing.assert_array_equal(cloud_points(changed(cloud(points), row_step=2**32 - 1)), points)


def test_other_containers_of_bytes_are_read() -> None:
    points = some_points(6)
    message = cloud(points)
    for data in (bytes(message.data), bytearray(message.data), np.frombuffer(message.data, np.uint8)):
        np.testing.assert_array_equal(cloud_points(changed(message, data=data)), points)
    for count in (0, 1):  # some drivers leave it 0
        message.fields[1].count = count
        np.testing.assert_array_equal(cloud_points(message), points)


@pytest.mark.parametrize(("height", "width"), [(0, 0), (1, 0), (0, 2**32 - 1), (2**32 - 1, 0)])
def test_no_points_are_no_error_unless_there_is_data(height: int, width: int) -> None:
    empty = changed(cloud(some_points(3)), height=height, width=width, data=array("B"), fields=[], point_step=0)
    assert cloud_points(empty).shape == (0, 3)
    with pytest.raises(PartError, match=rf"^width, height: {width} x {height} points, but data has 36 bytes"):
        cloud_points(changed(cloud(some_points(3)), height=height, width=width))


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"fields": []}, r"^fields: expected one each of x, y and z, got \[\]"),
    ({"fields": [field("x", 0), field("y", 4)]}, r"^fields: expected .* got \['x', 'y'\]"),
    ({"fields": [field("X", 0), field("y", 4), field("z", 8)]}, r"^fields: expected .* got \['X', 'y', 'z'\]"),
    ({"fields": [field("x", 0), field("x", 0), field("y", 4), field("z", 8)]}, "^fields: expected one each"),
    ({"fields": [field(f"f{k}", 0) for k in range(10_000)]}, r"^fields: expected .{50,300}\] \.\.\.$"),
    ({"fields": [field("x", 0, 5), field("y", 4), field("z", 8)]}, "^fields: expected x of datatype .* got 5"),
    ({"fields": [field("x", 0), field("y", 4, 0), field("z", 8)]}, "^fields: expected y of datatype .* got 0"),
    ({"fields": [field("x", 0), field("y", 4), field("z", 8, 255)]}, "^fields: expected z of datatype .* got 255"),
    ({"fields": [field("x", 0, 7, 3), field("y", 4), field("z", 8)]}, "^fields: expected x with count 1, got 3"),
    ({"fields": [field("x", 0), field("y", 4), field("z", 9)]}, "^fields: z ends at byte 13 .* point_step is 12"),
    ({"fields": [field("x", 2**32 - 1), field("y", 4), field("z", 8)]}, "^fields: x ends at byte 4294967299 "),
    ({"fields": [field("x", 0, 8), field("y", 5, 8), field("z", 4, 8)]}, "^fields: y ends at byte 13 "),
    ({"point_step": 0}, "^fields: x ends at byte 4 of a point, but point_step is 0"),
    ({"point_step": 11}, "^fields: z ends at byte 12 of a point, but point_step is 11"),
    ({"point_step": 2**32 - 1}, "^row_step: expected at least .* 12884901885 bytes, got 36"),
    ({"row_step": 35}, "^row_step: expected at least width . point_step = 36 bytes, got 35"),
    ({"row_step": 0}, "^row_step: "),
    ({"row_step": 37}, "^data: 3 x 2 points need 73 bytes, got 72"),
    ({"row_step": 2**32 - 1}, "^data: 3 x 2 points need 4294967331 bytes, got 72"),
    ({"height": 3}, "^data: 3 x 3 points need 108 bytes, got 72"),
    ({"height": 2**32 - 1}, "^data: 3 x 4294967295 points need"),
    ({"width": 4}, "^row_step: "),
    ({"width": 2**32 - 1, "height": 1}, "^data: 4294967295 x 1 points need 51539607540 bytes, got 72"),
    ({"width": 2**32 - 1, "height": 2**32 - 1, "row_step": 2**32 - 1}, "^row_step: "),
    ({"data": array("B")}, "^data: 3 x 2 points need 72 bytes, got 0"),
]


@pytest.mark.parametrize(("wrong", "text"), WRONG)
def test_what_is_wrong_is_named_and_nothing_is_allocated(wrong: dict[str, Any], text: str) -> None:
    message = changed(cloud(some_points(6).reshape(2, 3, 3)), **wrong)
    for use in (cloud_points, lambda msg: soup_part(msg, {}, 2**40)):
        with pytest.raises(PartError, match=text):
            use(message)

        def refuse(use: Callable[[Any], Any] = use) -> None:
            try:
                use(message)
            except PartError:
                pass

        tracemalloc.start()
        refuse()
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 200_000


def test_truncated_at_every_byte() -> None:
    message = cloud(some_points(6).reshape(2, 3, 3), padding=2)
    for length in range(len(message.data) - 2):
        with pytest.raises(PartError, match=r"^data: 3 x 2 points need 74 bytes"):
            cloud_points(changed(message, data=message.data[:length]))


# Normals.


def with_normals(points: np.ndarray, normals: np.ndarray, kind: int = FLOAT32, big: bool = False) -> Cloud:
    """A cloud of six columns, as the Point Cloud Library writes points with normals."""
    size = 4 if kind == FLOAT32 else 8
    message = cloud(points, kind, big, point_step=7 * size)
    rows = np.frombuffer(message.data, np.uint8).copy()
    grid = np.ndarray((len(points), 3), (">" if big else "<") + f"f{size}", rows.data, 4 * size, (7 * size, size))
    grid[...] = normals
    message.fields += [field(f"normal_{axis}", (4 + k) * size, kind) for k, axis in enumerate("xyz")]
    message.data = array("B", rows.tobytes())
    return message


@ENDIAN
@pytest.mark.parametrize("kind", [FLOAT32, FLOAT64])
def test_normals_are_of_length_one_or_none(big: bool, kind: int) -> None:
    normals = np.array([[0, 0, -2], [3, 4, 0], [0, 0, 0], [math.nan, 0, 1], [math.inf, 0, 1], [0, -1e-30, 0]])
    huge = np.array([[1e300, 1e300, 0.0]]) if kind == FLOAT64 else np.array([[3e38, 3e38, 0.0]])
    message = with_normals(some_points(7), np.concatenate([normals, huge]), kind, big)
    found = cloud_normals(message)
    assert found is not None
    half = 1.0 / math.sqrt(2.0)
    expected = [[0, 0, -1], [0.6, 0.8, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0], [0, -1, 0], [half, half, 0]]
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0.0)
    np.testing.assert_array_equal(cloud_points(message), some_points(7))  # as without them


def test_normals_come_whole_or_not_at_all() -> None:
    points = some_points(4)
    assert cloud_normals(cloud(points)) is None
    message = with_normals(points, np.ones((4, 3)))
    half = changed(message, fields=message.fields[:5])
    with pytest.raises(PartError, match="fields: expected one each of normal_x, normal_y and normal_z, got"):
        cloud_normals(half)
    twice = changed(message, fields=[*message.fields, message.fields[-1]])
    with pytest.raises(PartError, match="fields: expected one each of normal_x, normal_y and normal_z, got"):
        cloud_normals(twice)
    wrong = changed(message, fields=[*message.fields[:5], field("normal_z", 24, 5)])
    with pytest.raises(PartError, match=r"fields: expected normal_z of datatype 7 \(FLOAT32\) or 8"):
        cloud_normals(wrong)
    outside = changed(message, fields=[*message.fields[:5], field("normal_z", 25)])
    with pytest.raises(PartError, match="fields: normal_z ends at byte 29 of a point, but point_step is 28"):
        cloud_normals(outside)
    nothing = changed(message, width=0, data=array("B"))
    assert cloud_normals(nothing).shape == (0, 3)  # type: ignore[union-attr]


# A soup of triangles.


def the_part(changes: Changes) -> Part:
    (part,) = changes.put
    assert changes.remove == () and changes.clear is None
    return part


def test_three_points_are_a_triangle() -> None:
    points = some_points(12)
    part = the_part(soup_part(cloud(points), {}, 4))
    np.testing.assert_array_equal(part.vertices, points)
    assert part.triangles is soup_triangles(4)
    assert (part.key, part.frame, part.stamp, part.locked) == ("cloud", "lidar", 12_000_000_034, False)
    assert part.field == "header.frame_id of mesh_cloud" and part.expires is None
    for values in (part.vertices, part.triangles):
        assert values.flags.owndata and not values.flags.writeable
    scene = Scene()
    assert scene.put("cloud", part.vertices, part.triangles).vertices is part.vertices


def test_points_that_did_not_change_are_the_same_array_and_others_a_deformation() -> None:
    store = MeshStore(100)
    points = some_points(300)
    first = the_part(soup_part(cloud(points), store.parts, 100))
    store.commit(Changes((first,)), 1)
    again = cloud(points)
    again.header = SimpleNamespace(frame_id="moved", stamp=SimpleNamespace(sec=13, nanosec=0))
    second = the_part(soup_part(again, store.parts, 100))
    assert second.vertices is first.vertices and (second.frame, second.stamp) == ("moved", 13_000_000_000)
    for row in (0, 299):
        other = points.copy()
        other[row, 2] += 1.0
        third = the_part(soup_part(cloud(other, FLOAT64), store.parts, 100))
        np.testing.assert_array_equal(third.vertices, other)
        assert third.vertices is not first.vertices and third.triangles is first.triangles
    fewer = the_part(soup_part(cloud(points[:3]), store.parts, 100))
    assert len(fewer.triangles) == 1 and len(fewer.vertices) == 3
    store.commit(soup_part(changed(cloud(points[:3]), width=0, data=array("B")), store.parts, 100), 2)
    assert not store.parts


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e50, -2e50])
def test_coordinates_that_cannot_be_are_located(value: float) -> None:
    points = some_points(6)
    points[4, 1] = value
    with pytest.raises(PartError, match=r"^data: expected finite coordinates .* for y of point 4"):
        soup_part(cloud(points, FLOAT64), {}, 10)


def test_counts_are_judged_before_points_are_read() -> None:
    with pytest.raises(PartError, match=r"^width, height: expected a multiple of 3 points.* got 4 x 2 = 8"):
        soup_part(cloud(some_points(8).reshape(2, 4, 3)), {}, 10)
    with pytest.raises(PartError, match=r"^bounds.max_triangles: the cloud has 4 triangles, the bound is 3"):
        soup_part(cloud(some_points(12)), {}, 3)
    # All three coordinates from the same bytes: a message of a byte a point would become 24 bytes a point.
    message = cloud(some_points(3), offsets=(0, 0, 0), point_step=4)
    message.data, message.width = array("B", bytes(3_000_000 * 4)), 3_000_000
    tracemalloc.start()
    with pytest.raises(PartError, match=r"^bounds.max_triangles: the cloud has 1000000 triangles"):
        soup_part(message, {}, 999_999)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100_000


# Fuzz.


def mutated(rng: np.random.Generator, message: Cloud) -> Cloud:
    """One to three fields of the message are something else."""
    message = changed(message, fields=[SimpleNamespace(**vars(item)) for item in message.fields])
    counts = [0, 1, 2, 3, 6, 9, 12, 16, 24, 35, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1]
    for _ in range(rng.integers(1, 4)):
        what = rng.integers(0, 9)
        number = int(rng.choice(counts)) if rng.random() < 0.7 else int(rng.integers(0, 100))
        if what < 4:
            setattr(message, ("height", "width", "point_step", "row_step")[what], number)
        elif what == 4:
            message.is_bigendian = not message.is_bigendian
        elif what == 5:
            message.data = message.data[: rng.integers(0, len(message.data) + 1)]
        elif what == 6:
            message.data = array("B", rng.bytes(int(rng.integers(0, 400))))
        elif what == 7 and message.fields:
            item = message.fields[rng.integers(0, len(message.fields))]
            name = ("offset", "datatype", "count", "name")[rng.integers(0, 4)]
            values = {"offset": number, "datatype": number % 256, "count": number, "name": "xyzw"[number % 4]}
            setattr(item, name, values[name])
        elif what == 8:
            message.fields = message.fields[: rng.integers(0, 4)] + message.fields[: rng.integers(0, 2)]
    return message


def expected_points(message: Cloud) -> list[list[float]]:
    """The points of a good message, coordinate by coordinate out of its bytes."""
    data, found = bytes(message.data), []
    wanted = [next(item for item in message.fields if item.name == name) for name in "xyz"]
    for row in range(message.height):
        for column in range(message.width):
            at = row * message.row_step + column * message.point_step
            order = ">" if message.is_bigendian else "<"
            kinds = ["f" if item.datatype == FLOAT32 else "d" for item in wanted]
            pairs = zip(kinds, wanted, strict=True)
            found.append([struct.unpack_from(order + kind, data, at + item.offset)[0] for kind, item in pairs])
    return found


def test_fuzz() -> None:
    """Refused with a reason that names a field, or exactly the points that are in the bytes; nothing else."""
    rng = np.random.default_rng(20261122)
    seeds = [
        cloud(some_points(count).reshape(-1, width, 3), datatype, big, padding=padding)
        for count, width in ((3, 3), (6, 3), (12, 12), (6, 1))
        for datatype in (FLOAT32, FLOAT64)
        for big in (False, True)
        for padding in (0, 5)
    ]
    accepted = refused = parts = 0
    known: dict[str, Part] = {}
    for _ in range(4000):
        message = mutated(rng, seeds[rng.integers(0, len(seeds))])
        try:
            points = cloud_points(message)
        except PartError as error:
            refused += 1
            assert str(error).split(":")[0] in ("fields", "width, height", "row_step", "data"), error
        else:
            accepted += 1
            assert points.nbytes <= 24 * len(message.data)
            if len(points):
                np.testing.assert_array_equal(points, np.array(expected_points(message)))
        try:
            changes = soup_part(message, known, 3)
        except PartError:
            continue
        for part in changes.put:
            parts += 1
            known[part.key] = part
            assert len(part.vertices) == 3 * len(part.triangles) <= 9 and np.isfinite(part.vertices).all()
    assert accepted > 400 and refused > 1500 and parts > 70, (accepted, refused, parts)


# The answer to a query.


def answer_rows(message: Any) -> np.ndarray:
    kinds = {2: "u1", 6: "<u4", FLOAT32: "<f4"}
    assert not message.is_bigendian
    layout = {
        "names": [item.name for item in message.fields],
        "offsets": [item.offset for item in message.fields],
        "formats": [kinds[item.datatype] for item in message.fields],
        "itemsize": message.point_step,
    }
    return np.frombuffer(message.data, np.dtype(layout)).reshape(message.height, message.width)


def test_an_answer_has_the_points_and_what_reaches_them() -> None:
    points = some_points(6)
    points[2, 0], points[3] = np.nan, (1e300, -1e300, 1e-60)
    query = cloud(points.reshape(2, 3, 3), FLOAT64, True, padding=9)
    before = bytes(query.data)
    bits = np.array([0, 1, 2**31, 2**32 - 1, 5, 6], np.uint32)
    known = np.array([True, True, False, True, False, True])
    answer = visibility_cloud(query, cloud_points(query), bits, known)
    assert isinstance(answer, Cloud) and answer.header is query.header
    assert (answer.height, answer.width, answer.point_step, answer.row_step) == (2, 3, 20, 60)
    assert len(answer.data) == 120 and isinstance(answer.data, array) and answer.is_dense is False
    rows = answer_rows(answer)
    with np.errstate(over="ignore"):
        wanted = points.astype(np.float32)
    np.testing.assert_array_equal(cloud_points(answer), wanted)
    np.testing.assert_array_equal(rows["lights"].ravel(), bits)
    np.testing.assert_array_equal(rows["known"].ravel(), known.astype(np.uint8))
    assert bytes(query.data) == before


def test_an_answer_about_cones_has_two_more_fields() -> None:
    points, numbers = some_points(3), np.array([0, 5, 2**32 - 1], np.uint32)
    query = cloud(points)
    answer = visibility_cloud(query, points, numbers, np.array([1, 0, 1], bool), (numbers[::-1], numbers + 1))
    assert [(item.name, item.offset) for item in answer.fields][3:] == [
        ("lights", 12),
        ("known", 16),
        ("free", 20),
        ("blocked", 24),
    ]
    assert (answer.point_step, answer.row_step, len(answer.data)) == (28, 84, 84)
    rows = np.frombuffer(bytes(answer.data), "<u4").reshape(3, 7)
    np.testing.assert_array_equal(rows[:, 3:], np.stack([numbers, [1, 0, 1], numbers[::-1], numbers + 1], axis=1))
    for wrong in ((numbers, numbers[:2]), (np.array([-1, 0, 0]), numbers)):
        with pytest.raises(ValueError, match="^certain: expected"):
            visibility_cloud(query, points, numbers, np.ones(3, bool), wrong)


@ENDIAN
@pytest.mark.parametrize("datatype", [FLOAT32, FLOAT64])
def test_how_wide_cones_are(datatype: int, big: bool) -> None:
    """In the field of either name, of either type, at any place; or there is none."""
    most = {"radius": 10.0, "half_angle": 1.5}
    message = cloud(np.abs(some_points(6)).reshape(2, 3, 3), datatype, big, padding=5)
    assert cloud_cones(message, most) is None
    wide = cloud_points(message)[:, 1]
    for name in most:
        message.fields[1].name = name
        with pytest.raises(PartError, match=f"^data: expected {name} from 0 to"):
            cloud_cones(message, dict.fromkeys(most, float(np.sort(wide)[-2])))
        found = cloud_cones(message, dict.fromkeys(most, 1e50))
        assert found is not None and found[0] == name
        np.testing.assert_array_equal(found[1], wide)
    message.fields[0].name = "radius"
    with pytest.raises(PartError, match="^fields: expected radius or half_angle, got both"):
        cloud_cones(message, most)


def test_an_answer_has_the_container_that_the_query_has() -> None:
    query = cloud(some_points(2))
    query.data = np.frombuffer(query.data, np.uint8)
    answer = visibility_cloud(query, cloud_points(query), np.zeros(2, np.uint8), np.ones(2, bool))
    assert isinstance(answer.data, np.ndarray) and answer.data.dtype == np.uint8 and answer.data.shape == (40,)
    assert answer.is_dense is True and type(answer.fields[0]) is SimpleNamespace


@pytest.mark.parametrize(
    ("points", "bits", "known", "text"),
    [
        (np.zeros((3, 3)), np.zeros(2, np.uint32), np.ones(2, bool), r"^points: expected shape \(2, 3\)"),
        (np.zeros((2, 3)), np.zeros(3, np.uint32), np.ones(2, bool), r"^bits: expected shape \(2,\)"),
        (np.zeros((2, 3)), np.zeros(2, np.uint32), np.ones((2, 1), bool), r"^known: expected shape \(2,\)"),
        (np.zeros((2, 3)), np.array([0, 2**32]), np.ones(2, bool), "^bits: expected integers from 0"),
        (np.zeros((2, 3)), np.array([-1, 0]), np.ones(2, bool), "^bits: expected integers from 0"),
        (np.zeros((2, 3)), np.zeros(2), np.ones(2, bool), "^bits: expected integers from 0"),
    ],
)
def test_an_answer_refuses_arrays_that_do_not_fit(points: Any, bits: Any, known: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        visibility_cloud(cloud(some_points(2)), points, bits, known)


# The messages themselves.


@pytest.mark.skipif(importlib.util.find_spec("sensor_msgs") is None, reason="needs the ROS messages")
@ENDIAN
def test_messages_of_ros_go_in_and_come_out(big: bool) -> None:
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2, PointField
    from std_msgs.msg import Header

    points = some_points(6)
    double = cloud(points.reshape(2, 3, 3), FLOAT64, big, padding=4)
    message = PointCloud2(
        header=Header(frame_id="map"),
        height=2,
        width=3,
        fields=[PointField(**vars(item)) for item in double.fields],
        is_bigendian=big,
        point_step=double.point_step,
        row_step=double.row_step,
        data=double.data,
    )
    message.header.stamp.sec, message.header.stamp.nanosec = 5, 6
    message = deserialize_message(serialize_message(message), PointCloud2)
    np.testing.assert_array_equal(cloud_points(message), points)
    part = the_part(soup_part(message, {}, 2))
    assert (part.frame, part.stamp) == ("map", 5_000_000_006)
    sent = visibility_cloud(message, points, np.arange(6, dtype=np.uint32), np.ones(6, bool))
    answer = deserialize_message(serialize_message(sent), PointCloud2)
    assert answer == sent and answer.header == message.header and answer.is_dense is True
    np.testing.assert_array_equal(cloud_points(answer), points)
    np.testing.assert_array_equal(answer_rows(answer)["lights"].ravel(), np.arange(6))
    empty = visibility_cloud(PointCloud2(width=2**32 - 1), np.empty((0, 3)), [], [])
    assert deserialize_message(serialize_message(empty), PointCloud2) == empty and len(empty.fields) == 5
    assert soup_part(PointCloud2(), {}, 1) == Changes(remove=("cloud",))


def test_no_ros_is_imported() -> None:
    program = """
import sys
for name in ("rclpy", "sensor_msgs", "std_msgs", "geometry_msgs", "builtin_interfaces", "trimesh"):
    sys.modules[name] = None
import shadow_tracer.ros.wire.clouds, shadow_tracer.ros.mesh_files
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[3])
