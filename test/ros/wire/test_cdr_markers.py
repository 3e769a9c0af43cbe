# SPDX-License-Identifier: Apache-2.0
"""The parser of raw Marker and MarkerArray survives any bytes, and what it accepts is what was written."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from cdr_mutations import mutate

from shadow_tracer.ros.wire.cdr_markers import (
    LEAST,
    MarkerMessage,
    MarkersWriter,
    check_size,
    encode_marker,
    encode_markers,
    parse_marker,
    parse_markers,
)
from shadow_tracer.ros.wire.cdr_reader import LONGEST_NAME, Writer
from shadow_tracer.ros.wire.parts import PartError

ENDIAN = pytest.mark.parametrize("little", [True, False], ids=["little", "big"])
FORMS = pytest.mark.parametrize("form", ["marker", "array"])
MANY = 10**9


def random_marker(rng: np.random.Generator, points: int | None = None) -> MarkerMessage:
    def numbers(count: int) -> tuple[float, ...]:
        return tuple(float(value) for value in rng.normal(size=count))

    def name() -> str:
        return "".join(rng.choice(list("ab/_é日🤖 \n"), int(rng.integers(0, 9))))

    return MarkerMessage(
        ns=name(),
        id=int(rng.integers(-(2**31), 2**31)),
        type=int(rng.integers(0, 13)),
        action=int(rng.integers(0, 4)),
        frame=name(),
        stamp=int(rng.integers(-(2**31), 2**31)) * 10**9 + int(rng.integers(0, 10**9)),
        position=numbers(3),
        orientation=numbers(4),
        scale=numbers(3),
        color=tuple(float(np.float32(value)) for value in rng.random(4)),
        lifetime=int(rng.integers(-(2**31), 2**31)) * 10**9 + int(rng.integers(0, 10**9)),
        frame_locked=bool(rng.integers(0, 2)),
        points=rng.normal(size=(int(rng.integers(0, 8)) if points is None else points, 3)),
    )


def assert_equal(one: MarkerMessage, other: MarkerMessage) -> None:
    for name in MarkerMessage.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def parse(form: str, data: bytes) -> list[MarkerMessage]:
    return [parse_marker(data, MANY)] if form == "marker" else parse_markers(data, MANY)


def sample(form: str, little: bool, seed: int = 1) -> bytes:
    rng = np.random.default_rng(seed)
    if form == "marker":
        return encode_marker(random_marker(rng, 3), little)
    return encode_markers([random_marker(rng, 3), random_marker(rng, 0), random_marker(rng, 1)], little)


def refusal(form: str, data: bytes) -> str:
    """Why it is refused, "" if it is not; anything else than a PartError passes through."""
    try:
        check(parse(form, data))
    except PartError as error:
        assert str(error)
        return str(error)
    return ""


def check(markers: Sequence[MarkerMessage]) -> None:
    """What holds for every accepted message, whatever the bytes were."""
    for marker in markers:
        assert marker.points.ndim == 2 and marker.points.shape[1] == 3 and marker.points.dtype.kind == "f"
        assert "\0" not in marker.ns + marker.frame and len(marker.ns) <= LONGEST_NAME
        assert (marker.ns + marker.frame).encode("utf-8") is not None
        assert all(isinstance(value, int) for value in (marker.id, marker.type, marker.action, marker.stamp))
        assert isinstance(marker.frame_locked, bool)
        float(marker.points.sum())  # touches every byte of the view


@ENDIAN
def test_round_trip(little: bool) -> None:
    rng = np.random.default_rng(7)
    for number in range(200):
        marker = random_marker(rng)
        assert_equal(parse_marker(encode_marker(marker, little), MANY), marker)
        markers = [random_marker(rng) for _ in range(number % 6)]
        parsed = parse_markers(encode_markers(markers, little), MANY)
        assert len(parsed) == len(markers)
        for one, other in zip(parsed, markers, strict=True):
            assert_equal(one, other)


def test_points_are_not_copied() -> None:
    data = encode_marker(random_marker(np.random.default_rng(3), 30))
    points = parse_marker(data, MANY).points
    assert np.shares_memory(points, np.frombuffer(data, np.uint8)) and not points.flags.writeable


@ENDIAN
@FORMS
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_truncated_at_every_byte(form: str, little: bool, seed: int) -> None:
    data = sample(form, little, seed)
    for length in range(len(data)):
        assert "byte" in refusal(form, data[:length])


@ENDIAN
@FORMS
@pytest.mark.parametrize("count", [2**16, 2**28, 2**31 - 1, 2**31, 2**32 - 1])
def test_any_number_may_be_huge(form: str, little: bool, count: int) -> None:
    """Wherever a count stands, nothing is allocated for it."""
    data = sample(form, little)
    refusal(form, data)  # caches are filled
    refused = 0
    tracemalloc.start()
    for offset in range(4, len(data) - 3, 4):
        changed = bytearray(data)
        struct.pack_into("<I" if little else ">I", changed, offset, count)
        refused += bool(refusal(form, bytes(changed)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert refused >= 13 and peak < 30_000  # a marker has 13 counts


@ENDIAN
def test_counts_are_explained(little: bool) -> None:
    rng = np.random.default_rng(1)
    data = bytearray(encode_markers([random_marker(rng)], little))
    struct.pack_into("<I" if little else ">I", data, 4, 2**32 - 1)
    assert refusal("array", bytes(data)).startswith(f"markers: {2**32 - 1} of them need at least")
    data = bytearray(encode_marker(MarkerMessage(points=np.zeros((3, 3))), little))
    offset = 4 + 148  # where the number of points stands, if both names are empty
    assert struct.unpack_from("<I" if little else ">I", data, offset) == (3,)
    struct.pack_into("<I" if little else ">I", data, offset, 2**31)
    assert refusal("marker", bytes(data)).startswith(f"points: {2**31} of them need {24 * 2**31} bytes, but ")
    two = encode_markers([MarkerMessage(points=np.zeros((3, 3)))] * 2, little)
    assert refusal("array", two[:-60]).startswith("markers[1].")


def test_more_triangles_than_fit_are_refused() -> None:
    rng = np.random.default_rng(1)
    marker = MarkerMessage(points=rng.normal(size=(15, 3)))
    assert len(parse_marker(encode_marker(marker), 5).points) == 15
    with pytest.raises(PartError, match=r"bounds\.max_triangles: the markers have 5 triangles, the bound is 4"):
        parse_marker(encode_marker(marker), 4)
    assert len(parse_markers(encode_markers([marker] * 3), 15)) == 3
    with pytest.raises(PartError, match="have 15 triangles, the bound is 14"):
        parse_markers(encode_markers([marker] * 3), 14)
    # what casts nothing needs no room
    check_size([MarkerMessage(type=5, points=marker.points), MarkerMessage(action=2, points=marker.points)], 0)


@FORMS
def test_what_follows_the_message_is_refused_unless_it_is_padding(form: str) -> None:
    data = sample(form, True)
    check(parse(form, data + bytes(7)))
    assert "8 bytes are left over" in refusal(form, data + bytes(8))
    assert refusal(form, bytes([0, 1, 0, 0]) + bytes(64))  # zeros of another type are not an empty message
    assert parse_markers(bytes([0, 1, 0, 0]) + bytes(4), MANY) == []


@FORMS
@pytest.mark.parametrize("header", [b"\x00\x02", b"\x00\x03", b"\x00\x06", b"\x00\x07", b"\x00\x09", b"\xff\xff"])
def test_other_encapsulations_are_refused(form: str, header: bytes) -> None:
    assert refusal(form, header + sample(form, True)[2:]).startswith("header: expected plain CDR")


def by_hand(frame: bytes, ns: bytes, locked: int = 0, last: int = 0, little: bool = True) -> bytes:
    """A marker with the given bytes as names, whose other strings take none at all."""
    writer = Writer(little)
    writer.numbers("iI", 4, 0, 0)
    for name in (frame, ns):
        writer.array(np.frombuffer(name, np.uint8)[:, None], "u1")
    writer.numbers("3i", 4, 7, 11, 0)
    writer.numbers("10d4fiIB", 8, *[0.5] * 14, 0, 0, locked)
    for _ in range(3):
        writer.numbers("I", 4, 0)  # points, colors, texture_resource
    writer.numbers("iI", 4, 0, 0)
    for _ in range(8):
        writer.numbers("I", 4, 0)
    writer.numbers("B", 1, last)
    return writer.message()


@pytest.mark.parametrize(
    ("raw", "name"),
    [
        (b"", ""),
        (b"\0", ""),
        (b"arm\0", "arm"),
        (b"arm", "arm"),
        (b"a\0rm\0", "a"),
        (b"\xff\xfe\0", "\ufffd\ufffd"),
        ("é".encode()[:1] + b"\0", "\ufffd"),
        (b"\xed\xa0\x80\0", "\ufffd\ufffd\ufffd"),
    ],
)
@ENDIAN
def test_names_of_any_bytes(raw: bytes, name: str, little: bool) -> None:
    data = by_hand(raw, raw, little=little)
    marker = parse_marker(data, MANY)
    assert (marker.frame, marker.ns, marker.id) == (name, name, 7)
    for length in range(len(data)):
        assert refusal("marker", data[:length])


def test_the_shortest_marker_passes_the_check_of_the_count() -> None:
    data = by_hand(b"", b"")
    # In an array it starts 4 bytes later, where the gap before the pose is gone.
    first = data[4 : 4 + 28]
    array = b"\x00\x01\x00\x00" + struct.pack("<I", 1) + first + data[4 + 32 :]
    assert len(array) - 8 == LEAST
    assert parse_markers(array, MANY)[0].id == 7


def test_names_have_a_longest() -> None:
    assert len(parse_marker(by_hand(b"", b"n" * LONGEST_NAME), MANY).ns) == LONGEST_NAME
    assert refusal("marker", by_hand(b"", b"n" * (LONGEST_NAME + 1))).startswith("ns: expected at most 4096 bytes")
    assert refusal("marker", by_hand(b"n" * (LONGEST_NAME + 1), b"")).startswith("header.frame_id: expected at most")


def test_flags_are_0_or_1() -> None:
    assert parse_marker(by_hand(b"", b"", 1, 1), MANY).frame_locked
    assert refusal("marker", by_hand(b"", b"", 2)) == "frame_locked: expected 0 or 1, got 2"
    assert refusal("marker", by_hand(b"", b"", 0, 3)) == "mesh_use_embedded_materials: expected 0 or 1, got 3"
    ordinary = encode_marker(MarkerMessage())
    assert refusal("marker", ordinary[:-1] + b"\2") == "mesh_use_embedded_materials: expected 0 or 1, got 2"


@FORMS
def test_fuzz(form: str) -> None:
    """Flipped bytes, wrong counts, cuts, insertions, garbage: refused with a reason, or markers."""
    rng = np.random.default_rng(20261122)
    seeds = [sample(form, little, seed) for seed in range(6) for little in (True, False)]
    accepted = 0
    for number in range(6000):
        data = bytearray(seeds[number % len(seeds)])
        for _ in range(int(rng.integers(1, 4))):
            data = mutate(rng, data)
        accepted += not refusal(form, bytes(data))
    assert 300 < accepted < 5000  # the fuzz reaches both outcomes


@pytest.mark.parametrize("encode", [encode_marker, lambda marker: encode_markers([marker])], ids=["marker", "array"])
def test_encode_refuses_wrong_shapes(encode: Callable[[MarkerMessage], bytes]) -> None:
    with pytest.raises(ValueError, match=r"points: expected shape \(N, 3\), got \(3, 4\)"):
        encode(MarkerMessage(points=np.zeros((3, 4))))


@pytest.mark.parametrize("added", [0, 1, 3])
def test_markers_written_one_by_one_are_as_many_as_was_said(added: int) -> None:
    writer = MarkersWriter(2)
    for _ in range(added):
        writer.add(MarkerMessage())
    with pytest.raises(ValueError, match=r"count: expected the markers that were added, got [+-]\d of them"):
        writer.message()
