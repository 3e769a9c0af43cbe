# SPDX-License-Identifier: Apache-2.0
"""The parser of raw shape_msgs/Mesh survives any bytes, and what it accepts is a mesh."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from cdr_mutations import mutate

from shadow_tracer.ros.wire.cdr import MeshMessage, MeshMessageError, encode_mesh, parse_mesh

ENDIAN = pytest.mark.parametrize("little", [True, False], ids=["little", "big"])


def sample(triangles: int = 5, vertices: int = 7, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(vertices, 3)), rng.integers(0, vertices, (triangles, 3))


def check(mesh: MeshMessage) -> None:
    """What holds for every accepted mesh, whatever the bytes were."""
    assert mesh.triangles.dtype == np.int32 and mesh.triangles.shape[1] == 3
    assert mesh.vertices.dtype == np.float64 and mesh.vertices.flags.aligned and mesh.vertices.shape[1] == 3
    assert np.isfinite(mesh.vertices).all()
    if len(mesh.triangles):
        assert 0 <= mesh.triangles.min() and mesh.triangles.max() < len(mesh.vertices)


@ENDIAN
@pytest.mark.parametrize(("triangles", "vertices"), [(0, 0), (0, 1), (1, 3), (2, 4), (5, 7), (64, 33)])
def test_round_trip(little: bool, triangles: int, vertices: int) -> None:
    points, corners = sample(triangles, vertices)
    mesh = parse_mesh(encode_mesh(points, corners, little), 100)
    check(mesh)
    np.testing.assert_array_equal(mesh.vertices, points)
    np.testing.assert_array_equal(mesh.triangles, corners)


@ENDIAN
@pytest.mark.parametrize("triangles", [4, 5])
def test_truncated_at_every_byte(little: bool, triangles: int) -> None:
    data = encode_mesh(*sample(triangles), little)
    for length in range(len(data)):
        with pytest.raises(MeshMessageError, match="bytes|byte"):
            parse_mesh(data[:length], 100)


@ENDIAN
@pytest.mark.parametrize("count", [2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1])
@pytest.mark.parametrize("which", ["triangles", "vertices"])
def test_counts_are_checked_before_anything_is_allocated(little: bool, count: int, which: str) -> None:
    changed = bytearray(encode_mesh(*sample(5, 5), little))
    struct.pack_into("<I" if little else ">I", changed, 4 if which == "triangles" else 8 + 5 * 12, count)
    data = bytes(changed)

    def refusal() -> str:
        try:
            parse_mesh(data, 2**32)
        except MeshMessageError as error:
            return str(error)
        return "accepted"

    assert refusal().startswith(f"{which}: {count} of them need")
    tracemalloc.start()
    refusal()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20_000


def test_bounds_are_named() -> None:
    points, corners = sample(5, 40)
    with pytest.raises(MeshMessageError, match=r"bounds\.max_triangles: the mesh has 5 triangles, the bound is 4"):
        parse_mesh(encode_mesh(points, corners), 4)
    with pytest.raises(MeshMessageError, match=r"bounds\.max_triangles: the mesh has 40 vertices"):
        parse_mesh(encode_mesh(points, corners), 13)
    check(parse_mesh(encode_mesh(points, corners), 14))


def test_index_out_of_range_is_located() -> None:
    points, corners = sample()
    corners[3, 1] = 7
    with pytest.raises(MeshMessageError, match="index 7 of triangle 3, corner 1 .* has 7 vertices"):
        parse_mesh(encode_mesh(points, corners), 100)
    with pytest.raises(MeshMessageError, match="out of range, the mesh has 0 vertices"):
        parse_mesh(encode_mesh(np.empty((0, 3)), corners), 100)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_coordinates_that_are_not_finite_are_located(value: float) -> None:
    points, corners = sample()
    corners[1, 2] = 4
    points[4, 2] = value
    with pytest.raises(MeshMessageError, match="coordinate z of vertex 4"):
        parse_mesh(encode_mesh(points, corners), 100)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_a_vertex_that_no_triangle_uses_may_be_anything(value: float) -> None:
    points, corners = sample()
    corners[corners == 4] = 3
    points[4, 2] = value
    mesh = parse_mesh(encode_mesh(points, corners), 100)
    np.testing.assert_array_equal(mesh.vertices, points)
    points[4, 2], points[corners[0, 0], 1] = 0.0, value  # known triangles are asked as well
    with pytest.raises(MeshMessageError, match=f"coordinate y of vertex {corners[0, 0]} is"):
        parse_mesh(encode_mesh(points, corners), 100, mesh)


def test_coordinates_that_no_scene_takes_are_located() -> None:
    points, corners = sample()
    points[1, 0] = 1e50
    check(parse_mesh(encode_mesh(points, corners), 100))
    points[1, 0] = -1.1e50
    with pytest.raises(MeshMessageError, match=r"coordinate x of vertex 1 is -1\.1e\+50, larger than 1e\+50 m"):
        parse_mesh(encode_mesh(points, corners), 100)


@pytest.mark.parametrize("header", [b"\x00\x06", b"\x00\x07", b"\xff\xff", b"\x01\x00"])
def test_other_encapsulations_are_refused(header: bytes) -> None:
    with pytest.raises(MeshMessageError, match="header: expected plain CDR"):
        parse_mesh(header + encode_mesh(*sample())[2:], 100)


def test_a_longer_message_is_no_empty_mesh() -> None:
    """Zeros at the start of another message must not read as "no triangles", which would light everything."""
    assert parse_mesh(bytes([0, 1, 0, 0]) + bytes(8), 100).triangles.shape == (0, 3)
    with pytest.raises(MeshMessageError, match="left over"):
        parse_mesh(bytes([0, 1, 0, 0]) + bytes(64), 100)
    check(parse_mesh(encode_mesh(*sample()) + bytes(3), 100))


@ENDIAN
def test_known_triangles_are_taken_over_only_if_they_are_the_same(little: bool) -> None:
    points, corners = sample()
    first = parse_mesh(encode_mesh(points, corners, little), 100)
    again = parse_mesh(encode_mesh(points + 1.0, corners, little), 100, first)
    assert again.triangles is first.triangles
    np.testing.assert_array_equal(again.vertices, points + 1.0)
    other = parse_mesh(encode_mesh(points, corners[::-1], little), 100, first)
    np.testing.assert_array_equal(other.triangles, corners[::-1])
    with pytest.raises(MeshMessageError, match="out of range"):
        parse_mesh(encode_mesh(points[:-1], corners, little), 100, first)


def test_same_bytes_in_another_byte_order_are_other_triangles() -> None:
    points = np.zeros((2**17, 3))
    little, big = np.array([(0x00000100, 0, 0)]), np.array([(0x00010000, 0, 0)])
    first = parse_mesh(encode_mesh(points, little, True), 2**17)
    second = parse_mesh(encode_mesh(points, big, False), 2**17, first)
    assert bytes(first.block) == bytes(second.block)
    np.testing.assert_array_equal(second.triangles, big)


def test_fuzz() -> None:
    """Flipped bytes, wrong counts, cuts, insertions, garbage: refused with a reason, or a mesh."""
    rng = np.random.default_rng(20261122)
    seeds = [
        encode_mesh(*sample(t, v), little) for t, v in ((0, 0), (1, 3), (5, 7), (30, 20)) for little in (True, False)
    ]
    known = parse_mesh(encode_mesh(*sample(5, 7)), 100)
    accepted = 0
    for number in range(6000):
        data = bytearray(seeds[number % len(seeds)])
        for _ in range(int(rng.integers(1, 4))):
            data = mutate(rng, data)
        try:
            mesh = parse_mesh(bytes(data), 100, known if number % 2 else None)
        except MeshMessageError as error:
            assert str(error)
            continue
        check(mesh)
        accepted += 1
    assert 300 < accepted < 5000  # the fuzz reaches both outcomes


def test_encode_refuses_wrong_shapes() -> None:
    with pytest.raises(ValueError, match=r"triangles: expected shape \(N, 3\), got \(3, 4\)"):
        encode_mesh(np.zeros((3, 3)), np.zeros((3, 4), int))
    with pytest.raises(ValueError, match="vertices: expected shape"):
        encode_mesh(np.zeros(3), np.zeros((1, 3), int))
