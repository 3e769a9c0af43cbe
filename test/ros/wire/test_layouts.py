# SPDX-License-Identifier: Apache-2.0
"""Raw parsing agrees with ROS, notices where it does not, and then leaves the reading to ROS."""

from __future__ import annotations

import struct
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray, UVCoordinate

from shadow_tracer.ros.wire import layouts
from shadow_tracer.ros.wire.cdr import encode_mesh, parse_mesh
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_marker, encode_markers, parse_marker, parse_markers
from shadow_tracer.ros.wire.grid_map import GRID_MAP
from shadow_tracer.ros.wire.layouts import MARKER, MARKERS, MESH, Layouts, marker_from, mesh_from
from shadow_tracer.ros.wire.parts import PartError

MANY = 10**9


def random_marker(rng: np.random.Generator) -> Marker:
    """A marker with everything in it, of lengths that leave all kinds of gaps."""

    def size() -> int:
        return int(rng.integers(0, 6)) if rng.random() < 0.7 else 0

    def name() -> str:
        return "".join(rng.choice(list("abc/_é日🤖"), size()))

    def point() -> Point:
        x, y, z = (float(value) for value in rng.normal(size=3))
        return Point(x=x, y=y, z=z)

    marker = Marker(ns=name(), id=int(rng.integers(-9, 9)), type=int(rng.integers(0, 13)))
    marker.header.frame_id = name()
    marker.header.stamp.sec, marker.header.stamp.nanosec = int(rng.integers(-(2**31), 2**31)), 999_999_999
    marker.action = int(rng.integers(0, 4))
    w, x, y, z = (float(value) for value in rng.normal(size=4))
    marker.pose = Pose(position=point(), orientation=Quaternion(x=x, y=y, z=z, w=w))
    marker.scale = Vector3(x=w, y=x, z=y)
    marker.color = ColorRGBA(r=0.25, g=0.5, b=0.75, a=float(rng.integers(0, 2)))
    marker.lifetime.sec, marker.lifetime.nanosec = int(rng.integers(-5, 5)), int(rng.integers(0, 10**9))
    marker.frame_locked = bool(rng.integers(0, 2))
    marker.points = [point() for _ in range(size())]
    marker.colors = [ColorRGBA()] * size()
    marker.texture_resource, marker.text, marker.mesh_resource = name(), name(), name()
    marker.texture.header.frame_id, marker.texture.format = name(), name()
    marker.texture.data, marker.mesh_file.data = rng.bytes(size()), rng.bytes(size())
    marker.uv_coordinates = [UVCoordinate()] * size()
    marker.mesh_file.filename = name()
    marker.mesh_use_embedded_materials = bool(rng.integers(0, 2))
    return marker


def assert_equal(one: MarkerMessage, other: MarkerMessage) -> None:
    for name in MarkerMessage.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_single_markers_are_read_as_ros_wrote_them() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        message = random_marker(rng)
        assert_equal(parse_marker(serialize_message(message), MANY), marker_from(message))


def test_arrays_are_read_as_ros_wrote_them() -> None:
    rng = np.random.default_rng(2)
    for number in range(60):
        message = MarkerArray(markers=[random_marker(rng) for _ in range(number % 9)])
        parsed = parse_markers(serialize_message(message), MANY)
        assert len(parsed) == len(message.markers)
        for ours, theirs in zip(parsed, message.markers, strict=True):
            assert_equal(ours, marker_from(theirs))


@pytest.mark.parametrize("count", [0, 1, 3, 4, 1000])
def test_every_number_of_points(count: int) -> None:
    points = np.random.default_rng(count).normal(size=(count, 3))
    message = Marker(points=[Point(x=x, y=y, z=z) for x, y, z in points.tolist()])
    np.testing.assert_array_equal(parse_marker(serialize_message(message), MANY).points, points)


def test_truncated_at_every_byte_of_what_ros_wrote() -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        message = random_marker(rng)
        for data, parse in (
            (serialize_message(message), parse_marker),
            (serialize_message(MarkerArray(markers=[message, random_marker(rng)])), parse_markers),
        ):
            for length in range(len(data)):
                with pytest.raises(PartError):
                    parse(data[:length], MANY)


def test_ros_reads_what_is_encoded_here() -> None:
    rng = np.random.default_rng(4)
    markers = [marker_from(random_marker(rng)) for _ in range(40)]
    for marker in markers:
        assert_equal(marker_from(deserialize_message(encode_marker(marker), Marker)), marker)
    array = deserialize_message(encode_markers(markers), MarkerArray)
    assert len(array.markers) == len(markers)
    for message, marker in zip(array.markers, markers, strict=True):
        assert_equal(marker_from(message), marker)
        assert (message.colors, message.text, message.mesh_file.filename) == ([], "", "")


def test_mutated_messages_mean_the_same_to_ros() -> None:
    """Whatever is accepted here, ROS reads the same way; what it cannot read is refused here, too."""
    rng = np.random.default_rng(20261122)
    seeds = [serialize_message(random_marker(rng)) for _ in range(20)]
    both = neither = 0
    for number in range(3000):
        data = bytearray(seeds[number % len(seeds)])
        for _ in range(int(rng.integers(1, 3))):
            where = int(rng.integers(4, len(data)))
            kind = int(rng.integers(0, 3))
            if kind == 0:
                data[where] = int(rng.choice([0, 1, 2, 5, 0x80, 0xC3, 0xFF]))
            elif kind == 1:
                struct.pack_into("<I", data, where & ~3 if where < len(data) - 4 else 4, int(rng.integers(0, 40)))
            else:
                data = data[: max(where, 8)]
        ours = _or_none(lambda raw: parse_marker(raw, MANY), bytes(data))
        theirs = _or_none(lambda raw: marker_from(deserialize_message(raw, Marker)), bytes(data))
        if ours is not None:
            assert theirs is not None
            assert_equal(ours, theirs)
            both += 1
        else:
            neither += theirs is None
    assert both > 400 and neither > 400


def _or_none(read: Callable[[bytes], MarkerMessage], data: bytes) -> MarkerMessage | None:
    try:
        return read(data)
    except (PartError, RuntimeError):  # RMWError is a RuntimeError
        return None


def test_the_layouts_of_this_ros_are_as_expected() -> None:
    assert Layouts().check() == {MESH: "", MARKER: "", MARKERS: "", GRID_MAP: ""}


def triangles_message(count: int = 2) -> Mesh:
    message = Mesh()
    message.triangles = [MeshTriangle(vertex_indices=[0, k, k + 1]) for k in range(count)]
    message.vertices = [Point(x=float(k), y=0.5, z=-1.0) for k in range(count + 2)]
    return message


@pytest.fixture
def by_objects() -> Layouts:
    """As if this ROS had other layouts."""
    slow = Layouts()
    slow.reasons = dict.fromkeys(slow.reasons, "another layout")
    return slow


def test_objects_give_the_same(by_objects: Layouts) -> None:
    rng = np.random.default_rng(5)
    raw = Layouts()
    for count in range(4):
        data = serialize_message(triangles_message(count))
        ours, theirs = raw.mesh(data, 10), by_objects.mesh(data, 10)
        for name in ("triangles", "vertices", "block"):
            one, other = getattr(ours, name), getattr(theirs, name)
            np.testing.assert_array_equal(one, other)
            assert one.dtype == other.dtype
        assert by_objects.mesh(data, 10, theirs).triangles is theirs.triangles
    messages = [random_marker(rng) for _ in range(5)]
    for message in messages:
        data = serialize_message(message)
        assert_equal(raw.marker(data, MANY), by_objects.marker(data, MANY))
    data = serialize_message(MarkerArray(markers=messages))
    for ours, theirs in zip(raw.markers(data, MANY), by_objects.markers(data, MANY), strict=True):
        assert_equal(ours, theirs)


def test_objects_are_refused_for_the_same_reasons(by_objects: Layouts) -> None:
    with pytest.raises(PartError, match=r"bounds\.max_triangles: the mesh has 2 triangles, the bound is 1"):
        by_objects.mesh(serialize_message(triangles_message()), 1)
    broken = triangles_message()
    broken.triangles[1].vertex_indices[2] = 99
    with pytest.raises(PartError, match="index 99 of triangle 1, corner 2"):
        mesh_from(broken, 10)
    marker = Marker(type=11, points=[Point()] * 6)
    for read, message in ((by_objects.marker, marker), (by_objects.markers, MarkerArray(markers=[marker]))):
        with pytest.raises(PartError, match=r"bounds\.max_triangles: the markers have 2 triangles, the bound is 1"):
            read(serialize_message(message), 1)
    for change in ({"ns": "n" * 5000}, {"ns": "é" * 2048}):
        for layout in (by_objects, Layouts()):
            with pytest.raises(PartError, match="ns: expected at most 4096 bytes"):
                layout.marker(serialize_message(Marker(**change)), 1)


@pytest.mark.parametrize("kind", ["mesh", "marker", "markers"])
def test_objects_survive_any_bytes(by_objects: Layouts, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    read = getattr(by_objects, kind)
    message = {"mesh": triangles_message(), "marker": Marker(), "markers": MarkerArray(markers=[Marker()])}[kind]
    good = serialize_message(message)
    for length in range(0, len(good) - 8, 3):
        with pytest.raises(PartError):
            read(good[:length], 100)
    rng = np.random.default_rng(6)
    for number in range(300):
        data = bytearray(good)
        if number % 2:
            struct.pack_into("<I", data, 4 * int(rng.integers(1, len(data) // 4)), int(rng.integers(0, 2**32)))
        else:
            data[4:] = rng.bytes(len(data) - 4)
        try:
            read(bytes(data), 100)
        except PartError as error:
            assert str(error)


def test_no_room_is_made_for_markers_that_cannot_be_there(by_objects: Layouts) -> None:
    data = bytearray(serialize_message(MarkerArray()) + bytes(100_000))
    for order, header in (("<I", b"\0\1"), (">I", b"\0\0")):
        data[:2] = header
        struct.pack_into(order, data, 4, 10_000)
        with pytest.raises(PartError, match=r"markers: 10000 of them do not fit into \d+ bytes"):
            by_objects.markers(bytes(data), MANY)
    for length in range(8):
        with pytest.raises(PartError):
            by_objects.markers(bytes(data[:length]), MANY)


def _other_vertices(data: bytes, bound: int, known: Any = None) -> Any:
    mesh = parse_mesh(data, bound, known)
    return type(mesh)(mesh.triangles, mesh.vertices + 1.0, mesh.block)


def _unreadable(data: bytes, *_: Any) -> Any:
    raise layouts.MeshMessageError("points: 7 of them need 168 bytes, but 3 are left")


def _fewer(data: bytes, bound: int) -> Any:
    return parse_markers(data, bound)[:1]


def _shifted(data: bytes, bound: int) -> Any:
    return MarkerMessage(**(vars(parse_marker(data, bound)) | {"frame": "elsewhere"}))


@pytest.mark.parametrize(
    ("name", "parser", "kind", "where"),
    [
        ("parse_mesh", _other_vertices, MESH, "1 triangles differ"),
        ("parse_marker", _unreadable, MARKER, "but 3 are left"),
        ("parse_marker", _shifted, MARKER, "frame 'f' came out as 'elsewhere'"),
        ("parse_markers", _unreadable, MARKERS, "but 3 are left"),
        ("parse_markers", _fewer, MARKERS, "2 markers came out as 1"),
    ],
)
def test_another_layout_is_noticed(
    monkeypatch: pytest.MonkeyPatch, name: str, parser: Any, kind: str, where: str
) -> None:
    checked = Layouts()
    with monkeypatch.context() as patch:
        patch.setattr(layouts, name, parser)
        if name == "parse_mesh":  # the objects end in the same parser, which is right about them
            patch.setattr(layouts, "mesh_from", lambda message, bound: _as_is(message))
        reasons = checked.check()
    assert where in reasons[kind] and reasons[kind].startswith(f"{kind} is laid out differently by this ROS (")
    assert [key for key, reason in reasons.items() if reason] == [kind]
    assert checked.check() == dict.fromkeys(reasons, "")


def _as_is(message: Mesh) -> Any:
    return parse_mesh(serialize_message(message), 10)


def test_without_ros_there_is_nothing_to_compare_with(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy.serialization", None)
    lonely = Layouts()
    assert lonely.check() == {MESH: "", MARKER: "", MARKERS: "", GRID_MAP: ""}
    assert len(lonely.mesh(encode_mesh(np.eye(3), np.array([(0, 1, 2)])), 10).triangles) == 1


@pytest.fixture
def executor() -> Iterator[SingleThreadedExecutor]:
    context = Context()
    rclpy.init(context=context, args=[])
    spinner = SingleThreadedExecutor(context=context)
    spinner.add_node(Node("layouts", context=context))
    yield spinner
    for node in spinner.get_nodes():
        node.destroy_node()
    spinner.shutdown()
    rclpy.shutdown(context=context)


def test_markers_come_through_the_middleware(executor: SingleThreadedExecutor) -> None:
    """Objects and encoded bytes, received raw."""
    node = executor.get_nodes()[0]
    received: list[bytes] = []
    node.create_subscription(MarkerArray, "markers", received.append, 10, raw=True)
    publisher = node.create_publisher(MarkerArray, "markers", 10)
    message = MarkerArray(markers=[random_marker(np.random.default_rng(9)) for _ in range(3)])
    expected = [marker_from(marker) for marker in message.markers]
    deadline = time.monotonic() + 20.0
    while publisher.get_subscription_count() == 0 and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.01)
    publisher.publish(message)
    publisher.publish(encode_markers(expected))
    while len(received) < 2 and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.01)
    assert len(received) == 2
    for data in received:
        for ours, theirs in zip(Layouts().markers(data, MANY), expected, strict=True):
            assert_equal(ours, theirs)
