# SPDX-License-Identifier: Apache-2.0
"""compressedDepth: every format of image_transport is read exactly, and whatever is damaged is refused."""

from __future__ import annotations

import struct
import sys
import tracemalloc
import zlib

import numpy as np
import pytest
from compressed_images import HEADER, compressed, inverse, rvl

from shadow_tracer.ros.wire.compressed_depth import decode
from shadow_tracer.ros.wire.messages import MessageError

CODECS = ("png", "rvl")


def depth_image(seed: int = 0, shape: tuple[int, int] = (48, 64), holes: float = 0.2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 65536, shape).astype(np.uint16)
    depth[rng.random(shape) < holes] = 0
    return depth


IMAGES = {
    "noise": depth_image(),
    "surface": (1500 + np.add.outer(np.arange(48), np.arange(64))).astype(np.uint16),
    "nothing measured": np.zeros((48, 64), np.uint16),
    "no hole": np.full((48, 64), 65535, np.uint16),
    "every other": np.where(np.indices((48, 64)).sum(0) % 2, depth_image(1, holes=0.0), 0).astype(np.uint16),
    "one pixel": np.array([[7]], np.uint16),
    "extremes": np.array([[65535, 1, 65535, 0, 1, 65535]], np.uint16),
    "odd sides": depth_image(2, (7, 13)),
}


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("name", IMAGES)
def test_steps_come_back(name: str, codec: str) -> None:
    found = decode(*compressed(IMAGES[name], codec))
    assert found.dtype == np.uint16 and found.flags.c_contiguous
    np.testing.assert_array_equal(found, IMAGES[name])


def test_rvl_as_written_by_hand() -> None:
    """Two zeros, three values: counts 2 and 3, then +4 (8 = nibbles 8, 1), -1 (1), +2 (4); then one zero, none."""
    stream = struct.pack("<IIII", 6, 1, 0x23811410, 0)
    assert decode("16UC1; compressedDepth rvl", HEADER.pack(0, 0, 0) + stream).tolist() == [[0, 0, 4, 3, 5, 0]]


@pytest.mark.parametrize("codec", CODECS)
def test_inverse_depth_becomes_metres(codec: str) -> None:
    metres = np.random.default_rng(3).uniform(0.3, 12.0, (48, 64)).astype(np.float32)
    metres[::5] = np.nan
    found = decode(*compressed(metres, codec))
    steps, a, b = inverse(metres)
    expected = np.array([np.float32(a) / (np.float32(v) - np.float32(b)) if v else np.nan for v in steps.ravel()])
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found.ravel(), expected.astype(np.float32))
    seen = np.nan_to_num(metres, nan=99.0) < 10.0
    assert np.isnan(found[~seen]).all()
    assert (np.abs(found - metres)[seen] <= metres[seen] ** 2 / a * 1.01).all()  # one step of quantisation


@pytest.mark.parametrize("data", [bytes, bytearray, memoryview, lambda data: np.frombuffer(data, np.uint8)])
def test_any_buffer_will_do(data: object) -> None:
    format, content = compressed(IMAGES["noise"], "rvl")
    np.testing.assert_array_equal(decode(format, data(content)), IMAGES["noise"])  # type: ignore[operator]


@pytest.mark.parametrize(
    "format", ["16UC1", "16UC1; compressedDepth", "16UC1;compressedDepth png", "mono16; compressedDepth png "]
)
def test_formats_of_older_senders_are_png(format: str) -> None:
    np.testing.assert_array_equal(decode(format, compressed(IMAGES["noise"])[1]), IMAGES["noise"])


@pytest.mark.parametrize(
    ("format", "message"),
    [
        ("", "format: expected an encoding of 16UC1, mono16, 32FC1 first, got ''"),
        ("png", "format: expected an encoding of"),
        ("rgb8; compressedDepth png", "format: expected an encoding of"),
        ("16UC1; png compressed ", "format: expected '<encoding>; compressedDepth png' or"),
        ("16UC1; compressedDepth zstd", "format: expected '<encoding>; compressedDepth png' or"),
        ("16UC1; ", "format: expected '<encoding>; compressedDepth png' or"),
    ],
)
def test_other_formats_are_refused(format: str, message: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(format, compressed(IMAGES["noise"])[1])
    assert str(caught.value).startswith(message)


def _chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def _png_of(width: int, height: int, bits: int = 16, colour: int = 0, rows: bytes = b"") -> bytes:
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    data = _chunk(b"IHDR", head) + _chunk(b"IDAT", zlib.compress(rows)) + _chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + data


def _rvl_of(width: int, height: int, *words: int) -> bytes:
    return struct.pack(f"<II{len(words)}I", width, height, *words)


@pytest.mark.parametrize(
    ("codec", "body", "message"),
    [
        ("png", b"", "data: expected more than the 12 bytes of its header, got 12"),
        ("png", b"\x89PNG", "data: expected a PNG after the header, got 4 bytes"),
        ("png", b"\xff\xd8\xff\xe0" + bytes(40), "data: expected a PNG after the header, got bytes that begin"),
        ("png", _png_of(4, 4, bits=8), "data: expected a PNG of 16 bit grey, got one of 8 bits with colour type 0"),
        ("png", _png_of(4, 4, colour=2), "data: expected a PNG of 16 bit grey, got one of 16 bits with colour type 2"),
        ("png", _png_of(0, 4), "data: expected an image of 1 to 65536 pixels a side, got 0 x 4"),
        ("png", _png_of(2**31 - 1, 2**31 - 1), "data: expected an image of 1 to 65536 pixels a side"),
        ("png", _png_of(65536, 65536), "data: expected at most bounds.max_rays = 10000 pixels, got 65536 x 65536"),
        ("png", _png_of(4, 4)[:-20], "data: the PNG is damaged"),
        ("rvl", b"\x01\0\0\0", "data: expected columns and rows in 8 bytes after the header, got 4 bytes"),
        ("rvl", _rvl_of(0, 4, 0), "data: expected an image of 1 to 65536 pixels a side, got 0 x 4"),
        ("rvl", _rvl_of(2**32 - 1, 2**32 - 1, 0), "data: expected an image of 1 to 65536 pixels a side"),
        ("rvl", _rvl_of(65536, 65536, 0), "data: expected at most bounds.max_rays = 10000 pixels, got 65536 x 65536"),
        ("rvl", _rvl_of(4, 4), "data: the RVL stream ends 16 pixels before the image does"),
        ("rvl", _rvl_of(4, 4, 0x10000000), "data: the RVL stream has a run of 0 + 0 pixels where 15 are left"),
        ("rvl", _rvl_of(4, 4, 0x09200000), "data: the RVL stream has a run of 0 + 17 pixels where 16 are left"),
        ("rvl", _rvl_of(4, 4, 0x08211111), "data: the RVL stream ends 16 pixels before the image does"),
        ("rvl", _rvl_of(4, 4, 0xFFFFFFFF, 0xFFFFFFFF, 0x70000000), "data: the RVL stream has a run of 4611686018"),
        ("rvl", _rvl_of(1, 1, 0x01888888, 0x10000000), "data: the RVL stream has a difference between pixels"),
    ],
)  # fmt: skip
def test_damaged_data_is_refused(codec: str, body: bytes, message: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(f"16UC1; compressedDepth {codec}", HEADER.pack(0, 0, 0) + body, 10_000)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0), (np.inf, 1.0), (1.0, np.nan)])
def test_quantisation_without_a_meaning_is_refused(a: float, b: float) -> None:
    with pytest.raises(MessageError, match="^data: expected finite quantisation parameters, the first above 0, got"):
        decode("32FC1; compressedDepth rvl", HEADER.pack(0, a, b) + rvl(IMAGES["noise"]))


@pytest.mark.parametrize("codec", CODECS)
def test_cut_short_anywhere(codec: str) -> None:
    format, data = compressed(IMAGES["odd sides"], codec)
    # After the last pixel a PNG has checksums and an end mark that nothing hangs on.
    for length in range(len(data) - 20 if codec == "png" else len(data)):
        with pytest.raises(MessageError):
            decode(format, data[:length], 100)


@pytest.mark.parametrize("codec", CODECS)
def test_damaged_bytes_never_raise_anything_else(codec: str) -> None:
    rng = np.random.default_rng(5)
    format, data = compressed(IMAGES["odd sides"], codec)
    refused = 0
    for _ in range(1000):
        damaged = bytearray(data)
        for place in rng.integers(0, len(data), rng.integers(1, 4)):
            damaged[place] = rng.integers(256)
        try:
            assert decode(format, damaged, 1000).size <= 1000
        except MessageError:
            refused += 1
    assert refused > 300


@pytest.mark.parametrize("body", [_png_of(65535, 20000), _rvl_of(65535, 20000, 0)], ids=CODECS)
def test_a_bomb_takes_no_memory(body: bytes) -> None:
    codec = "png" if body.startswith(b"\x89") else "rvl"
    tracemalloc.start()
    try:
        with pytest.raises(MessageError, match=r"bounds\.max_rays"):
            decode(f"16UC1; compressedDepth {codec}", HEADER.pack(0, 0, 0) + body, 1_310_720)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_bytes_after_an_rvl_stream_take_no_memory() -> None:
    """A message of many bytes for few pixels: no more of them are looked at than pixels can need."""
    format, data = compressed(IMAGES["odd sides"], "rvl")
    long = data + bytes(20_000_000)
    tracemalloc.start()
    try:
        np.testing.assert_array_equal(decode(format, long, 100), IMAGES["odd sides"])
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_without_pillow_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    np.testing.assert_array_equal(decode(*compressed(IMAGES["noise"], "rvl")), IMAGES["noise"])
    with pytest.raises(MessageError, match=r"pip install 'shadow_tracer\[compressed\]'"):
        decode("16UC1; compressedDepth png", HEADER.pack(0, 0, 0) + _png_of(4, 4))
