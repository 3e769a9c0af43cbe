# SPDX-License-Identifier: Apache-2.0
"""Depth images compressed as senders of compressedDepth do it, number by number, pixel by pixel; and damaged ones."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

HEADER = struct.Struct("<iff")


def png(steps: np.ndarray) -> bytes:
    """A PNG of (H, W) uint16."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(steps.astype(np.uint16)).save(file, "PNG")
    return file.getvalue()


def rvl(steps: np.ndarray) -> bytes:
    """Size and RVL stream of (H, W) uint16."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    values = [int(value) for value in steps.ravel()]
    place, previous = 0, 0
    while place < len(values):
        zeros = 0
        while place + zeros < len(values) and values[place + zeros] == 0:
            zeros += 1
        place += zeros
        others = 0
        while place + others < len(values) and values[place + others] != 0:
            others += 1
        put(zeros)
        put(others)
        for value in values[place : place + others]:
            difference = value - previous
            put(2 * difference if difference >= 0 else -2 * difference - 1)
            previous = value
        place += others
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int("".join(f"{nibble:x}" for nibble in nibbles[i : i + 8]), 16) for i in range(0, len(nibbles), 8)]
    height, width = steps.shape
    return struct.pack(f"<II{len(words)}I", width, height, *words)


def inverse(
    metres: np.ndarray, depth_max: float = 10.0, quantization: float = 100.0
) -> tuple[np.ndarray, float, float]:
    """(H, W) uint16 inverse depths of float32 metres, and the parameters A and B."""
    a = np.float32(quantization) * (np.float32(quantization) + np.float32(1.0))
    b = np.float32(1.0) - a / np.float32(depth_max)
    with np.errstate(all="ignore"):
        near = (metres > 0) & (metres < np.float32(depth_max))
        steps = np.where(near, a / np.where(near, metres, np.float32(1.0)) + b, np.float32(0.0))
    return steps.astype(np.uint16), float(a), float(b)


def compressed(depth: np.ndarray, codec: str = "png") -> tuple[str, bytes]:
    """Fields ``format`` and ``data`` for (H, W) uint16 steps or float32 metres."""
    steps, a, b = (depth, 0.0, 0.0) if depth.dtype == np.uint16 else inverse(depth)
    encoding = "16UC1" if depth.dtype == np.uint16 else "32FC1"
    body = png(steps) if codec == "png" else rvl(steps)
    return f"{encoding}; compressedDepth {codec}", HEADER.pack(0, a, b) + body


def compressed_msg(depth: np.ndarray, stamp: int, frame: str = "camera", codec: str = "png") -> Any:
    """The same as a sensor_msgs/CompressedImage with a stamp [ns]."""
    from sensor_msgs.msg import CompressedImage

    msg = CompressedImage()
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp, 10**9)
    msg.header.frame_id = frame
    msg.format, data = compressed(depth, codec)
    msg.data.frombytes(data)
    return msg


def _chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png_of(width: int, height: int, rows: bytes = b"", before: bytes = b"") -> bytes:
    """A PNG whose head promises so many pixels, whatever its rows hold; ``before`` are chunks in front of them."""
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + before + _chunk(b"IDAT", zlib.compress(rows)) + _chunk(b"IEND", b"")


def damaged(depth: np.ndarray) -> Iterator[tuple[str, str, bytes, str]]:
    """Messages that a receiver with room for a few times as many pixels must refuse.

    Args:
        depth: (H, W) uint16, not all 0.

    Yields:
        What is wrong, ``format``, ``data``, and how a refusal begins.
    """
    for codec in ("png", "rvl"):
        format, good = compressed(depth, codec)
        whole = len(good) - (20 if codec == "png" else 0)  # after the last pixel a PNG has checksums and an end mark
        for length in (0, 5, 12, 16, whole // 2, whole - 4):
            yield f"{codec} cut to {length} bytes", format, good[:length], "data: "
        yield f"{codec} called the other", format.replace(codec, "rvl" if codec == "png" else "png"), good, "data: "
        metres, (_, packed) = format.replace("16UC1", "32FC1"), compressed(depth * np.float32(0.001), codec)
        for a in (0.0, -1.0, float("nan"), float("inf")):
            yield f"{codec} with A {a}", metres, HEADER.pack(0, a, 1.0) + packed[12:], "data: expected finite quantis"
        for width, height in ((65536, 65536), (2**31 - 1, 2**31 - 1), (0, 48), (1, 2**31), (30000, 1)):
            body = png_of(width, height) if codec == "png" else struct.pack("<III", width, height, 0)
            yield f"{codec} of {width} x {height}", format, good[:12] + body, "data: expected "
    bomb = _chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(200_000_000), 9))
    yield (
        "png with 200 MB of text",
        "16UC1; compressedDepth png",
        bytes(12) + png_of(64, 48, b"", bomb),
        "data: the PNG",
    )
    run = struct.pack("<4I", 64, 48, 0xFFFFFFFF, 0xFFFFFFFF)
    yield "rvl with an endless run", "16UC1; compressedDepth rvl", bytes(12) + run, "data: the RVL stream"
    good = compressed(depth)[1]
    for format in ("", "jpeg", "rgb8; compressedDepth png", "16UC1; compressedDepth zstd", "16UC1; png", "a" * 3000):
        yield f"format {format[:30]!r}", format, good, "format: expected "
