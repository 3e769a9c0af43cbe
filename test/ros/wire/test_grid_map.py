# SPDX-License-Identifier: Apache-2.0
"""Bytes of a grid_map_msgs/GridMap: what a cell's place is, what is refused. No ROS is needed here."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cdr_mutations import mutate

from shadow_tracer import Scene
from shadow_tracer.ros.wire.cdr_reader import MeshMessageError
from shadow_tracer.ros.wire.grid_map import (
    DEFINITIONS,
    GRID_MAP,
    KEY,
    GridMap,
    GridPart,
    encode_grid_map,
    encode_shadow_grid,
    grid_part,
    parse_grid_map,
)

MANY = 10_000


def some_map(rows: int = 3, columns: int = 4, **changes: Any) -> GridMap:
    values = np.arange(rows * columns, dtype=np.float32).reshape(rows, columns) / 8
    return replace(GridMap("map", 5_000_000_007, 0.5, (10.0, -20.0), values), **changes)


def packed(**changes: Any) -> bytes:
    """A message with some fields of another value, in little endian: names as in the message."""
    grid_map = some_map()
    fields = {
        "resolution": 0.5, "length_x": 1.5, "length_y": 2.0, "x": 10.0, "y": -20.0, "z": 0.0,
        "q": (0.0, 0.0, 0.0, 1.0), "layers": ["elevation"], "data": 1, "labels": ("column_index", "row_index"),
        "sizes": (4, 3), "offset": 0, "numbers": grid_map.values.T.reshape(-1), "starts": (0, 0), "tail": b"",
    }  # fmt: skip
    assert fields.keys() >= changes.keys()
    fields |= changes
    out = bytearray(b"\0\1\0\0")

    def put(layout: str, size: int, *values: Any) -> None:
        out.extend(bytes((4 - len(out)) % size))
        out.extend(struct.pack("<" + layout, *values))

    def text(value: str) -> None:
        put("I", 4, len(value) + 1)
        out.extend(value.encode() + b"\0")

    put("iI", 4, 5, 7)
    text("map")
    place = ("resolution", "length_x", "length_y", "x", "y", "z")
    put("10d", 8, *(fields[name] for name in place), *fields["q"])
    put("I", 4, len(fields["layers"]))
    for name in fields["layers"]:
        text(name)
    put("I", 4, 0)
    put("I", 4, fields["data"])
    for _ in range(min(fields["data"], 3)):
        put("I", 4, len(fields["labels"]))
        for label, size, stride in zip(fields["labels"], fields["sizes"], (12, 3), strict=False):
            text(label)
            put("II", 4, size, stride)
        put("II", 4, fields["offset"], len(fields["numbers"]))
        out.extend(np.asarray(fields["numbers"], "<f4").tobytes())
    put("HH", 2, *fields["starts"])
    return bytes(out) + fields["tail"]


def test_what_is_packed_by_hand_is_what_the_encoder_writes() -> None:
    grid_map = some_map()
    assert packed() == encode_grid_map(grid_map, {"elevation": grid_map.values})


@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize("starts", [(0, 0), (2, 0), (0, 3), (1, 2)])
def test_a_ring_buffer_comes_out_as_it_went_in(little: bool, starts: tuple[int, int]) -> None:
    grid_map = some_map()
    layers = {"a": grid_map.values + 1, "elevation": grid_map.values, "": grid_map.values - 1}
    data = encode_grid_map(grid_map, layers, ["elevation"], little, starts)
    for name, wanted in layers.items():
        found = parse_grid_map(data, name, MANY)
        assert np.array_equal(found.values, wanted)
        assert (found.frame, found.stamp, found.resolution, found.center) == ("map", 5_000_000_007, 0.5, (10.0, -20.0))
    assert parse_grid_map(data + bytes(4), "a", MANY).values.shape == (3, 4)  # transports pad


def test_the_first_number_is_the_cell_at_the_largest_x_and_y() -> None:
    numbers = np.arange(12, dtype=np.float32)
    field = parse_grid_map(packed(numbers=numbers), "elevation", MANY).height_field()
    positions = field.positions()
    # 3 x 4 cells of 0.5 m around (10, -20): x from 9.5 to 10.5, y from -20.75 to -19.25, column by column
    assert positions[0, 0].tolist() == [10.5, -19.25, 0.0]
    assert positions[1, 0].tolist() == [10.0, -19.25, 1.0]
    assert positions[0, 1].tolist() == [10.5, -19.75, 3.0]
    assert positions[2, 3].tolist() == [9.5, -20.75, 11.0]
    moved = parse_grid_map(packed(numbers=numbers, starts=(1, 2)), "elevation", MANY)
    assert moved.values[0, 0] == numbers[2 * 3 + 1] and moved.values[2, 3] == numbers[1 * 3 + 0]


def test_what_is_not_finite_is_a_hole() -> None:
    numbers = np.zeros(12, np.float32)
    numbers[[0, 5, 7]] = np.nan, np.inf, -np.inf
    found = parse_grid_map(packed(numbers=numbers), "elevation", MANY)
    assert np.isnan(found.values.T.reshape(-1)).nonzero()[0].tolist() == [0, 5, 7]
    (part,) = grid_part(found, None).put
    assert isinstance(part, GridPart)
    assert part.surface.valid.sum() == 9 and not np.isnan(part.vertices[np.unique(part.drawn)]).any()
    assert 0 < len(part.drawn) < len(part.triangles)


REFUSED = [
    ({"layers": ["height"]}, "layers: expected one called 'elevation' (grid_map.layer), got 'height'"),
    ({"layers": [], "data": 0}, "layers: expected one called 'elevation' (grid_map.layer), got none"),
    ({"layers": ["elevation"] * 2, "data": 2}, "layers: expected one called"),
    ({"data": 2}, "data: expected one for each of 1 layers, got 2"),
    ({"data": 0xFFFFFFF0}, "data: expected one for each of 1 layers"),
    ({"resolution": 0.0}, "info.resolution: expected"),
    ({"resolution": np.nan}, "info.resolution: expected"),
    ({"length_x": 2.1}, "info.length_x: expected 3 cells of 0.5 m, 1.5 m, got 2.1 m"),
    ({"length_y": 1.0}, "info.length_y: expected 4 cells"),
    ({"length_y": np.inf}, "info.length_y: expected 0 to"),
    ({"x": np.nan}, "info.pose.position.x: expected"),
    ({"y": -1e60}, "info.pose.position.y: expected"),
    ({"z": 1.0}, "info.pose.position.z: expected 0"),
    ({"q": (0.0, 0.0, 0.7071, 0.7071)}, "info.pose.orientation: expected no rotation"),
    ({"q": (0.0, 0.0, 0.0, 2.0)}, "info.pose.orientation"),
    ({"q": (0.0, np.nan, 0.0, 1.0)}, "info.pose.orientation"),
    ({"labels": ("row_index", "column_index")}, "data[0].layout.dim: expected labels ['column_index', 'row_index']"),
    ({"labels": ("column_index",)}, "data[0].layout.dim: expected labels"),
    ({"sizes": (3, 3)}, "data[0].data: expected 3 x 3 numbers from data_offset 0 on, got 12 from 0 on"),
    ({"offset": 1}, "data[0].data: expected 3 x 4 numbers from data_offset 0 on, got 12 from 1 on"),
    ({"starts": (3, 0)}, "outer_start_index: expected less than 3, got 3"),
    ({"starts": (0, 4)}, "inner_start_index: expected less than 4, got 4"),
    ({"tail": bytes(16)}, "inner_start_index: 16 bytes are left over"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "text"), REFUSED, ids=[f"{list(c)[0]}-{n}" for n, (c, _) in enumerate(REFUSED)])
def test_refused_with_the_name_of_the_field(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(MeshMessageError) as refusal:
        parse_grid_map(packed(**changes), "elevation", MANY)
    assert str(refusal.value).startswith(text)


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, -1.0), (1e-9, 0.0, 0.0, 1.0)])
def test_quaternions_that_turn_nothing(q: tuple[float, ...]) -> None:
    assert parse_grid_map(packed(q=q), "elevation", MANY).values.shape == (3, 4)


def test_a_map_beyond_the_bound_is_refused_whole() -> None:
    assert parse_grid_map(packed(), "elevation", 12).values.shape == (3, 4)
    with pytest.raises(MeshMessageError, match=r"bounds.max_triangles: a map of 3 x 4 cells has 12 triangles"):
        parse_grid_map(packed(), "elevation", 11)


def test_every_cut_is_noticed() -> None:
    data = packed()
    for length in range(len(data)):
        with pytest.raises(MeshMessageError):
            parse_grid_map(data[:length], "elevation", MANY)


def test_any_bytes_are_survived() -> None:
    rng = np.random.default_rng(0)
    good, taken = packed(), 0
    for _ in range(3000):
        data = bytearray(good)
        for _ in range(int(rng.integers(1, 4))):
            data = mutate(rng, data)
        try:
            found = parse_grid_map(bytes(data), "elevation", MANY)
        except MeshMessageError:
            continue
        taken += 1
        found.height_field()
    assert 0 < taken < 3000


def test_a_map_without_cells_takes_the_ground_away() -> None:
    data = packed(length_x=0.0, length_y=0.0, sizes=(0, 0), numbers=[])
    assert grid_part(parse_grid_map(data, "elevation", MANY), None).remove == (KEY,)
    data = packed(length_x=0.5, length_y=0.5, sizes=(1, 1), numbers=[2.0])
    (part,) = grid_part(parse_grid_map(data, "elevation", MANY), None).put
    assert part.vertices.tolist() == [[10.0, -20.0, 2.0]] and not len(part.triangles)


def test_triangles_stay_while_cells_and_holes_do() -> None:
    first = grid_part(some_map(), None).put[0]
    again = grid_part(some_map(center=(11.0, -20.0)), first).put[0]
    assert again.triangles is first.triangles and again.vertices[0, 0] == first.vertices[0, 0] + 1.0
    holed = some_map().values.copy()
    holed[1, 1] = np.nan
    other = grid_part(some_map(values=holed), again).put[0]
    assert other.triangles is not first.triangles
    scene = Scene()
    for part in (first, again, other):
        assert isinstance(part, GridPart)
        scene.put_surface(KEY, part.surface)
        assert np.array_equal(scene[KEY].triangles, part.triangles)


def test_shadow_grid_has_x_along_its_rows_from_the_lower_left_corner() -> None:
    types = pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS2_JAZZY)
    dark = np.array([[0, 1, 2, 3], [10, 11, 12, 13], [20, 21, -1, 100]], np.int8)
    data = encode_shadow_grid(some_map(), dark, 9_000_000_001)
    found = store.deserialize_cdr(data, "nav_msgs/msg/OccupancyGrid")
    assert (found.header.frame_id, found.header.stamp.sec, found.header.stamp.nanosec) == ("map", 5, 7)
    assert (found.info.map_load_time.sec, found.info.map_load_time.nanosec) == (9, 1)
    assert (found.info.width, found.info.height, found.info.resolution) == (3, 4, 0.5)
    origin = found.info.origin
    assert (origin.position.x, origin.position.y, origin.position.z) == (9.25, -21.0, 0.0)
    assert (origin.orientation.z, origin.orientation.w) == (0.0, 1.0)
    assert found.data.reshape(4, 3).tolist() == [[100, 13, 3], [-1, 12, 2], [21, 11, 1], [20, 10, 0]]
    assert store.serialize_cdr(found, "nav_msgs/msg/OccupancyGrid") == data


def test_the_bytes_are_those_of_the_definition() -> None:
    types = pytest.importorskip("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(types.get_types_from_msg(text, name))
    grid_map = some_map()
    for frame, basic in (("map", ()), ("m", ("elevation",)), ("", ("a", "elevation"))):
        named = replace(grid_map, frame=frame)
        layers = {"elevation": grid_map.values, "hours": 2 * grid_map.values}
        data = encode_grid_map(named, layers, basic, starts=(1, 2))
        found = store.deserialize_cdr(data, GRID_MAP)
        assert found.layers == list(layers) and found.basic_layers == list(basic)
        assert [d.label for d in found.data[1].layout.dim] == ["column_index", "row_index"]
        assert [(d.size, d.stride) for d in found.data[1].layout.dim] == [(4, 12), (3, 3)]
        assert (found.outer_start_index, found.inner_start_index, found.info.length_y) == (1, 2, 2.0)
        assert found.data[1].data.reshape(4, 3)[2, 1] == 0.0  # where the ring begins
        assert store.serialize_cdr(found, GRID_MAP) == data
