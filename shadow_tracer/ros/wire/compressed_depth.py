# SPDX-License-Identifier: Apache-2.0
"""Depth images as the transport ``compressedDepth`` sends them (``sensor_msgs/CompressedImage``). No ROS here.

The data begins with 12 bytes: a format number (int32) and two quantisation parameters A and B (float32). Then comes one
image of 16 bits per pixel, as PNG or as RVL (A. D. Wilson, Fast Lossless Depth Image Compression, 2017). With the
encoding 16UC1 its values are the steps of the camera. With 32FC1 they are inverse depths: a value v stands for
A / (v - B) metres, and 0 for no measurement.
"""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.messages import DEPTH_ENCODINGS, LARGEST_SIDE, MessageError

_HEADER = struct.Struct("<iff")
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_START = struct.Struct(">8sI4sIIBB")  # signature, length and name of the first chunk, its first fields
_RVL_START = struct.Struct("<II")  # columns, rows
_LONGEST_NUMBER = 11  # nibbles, of three bits each, that an int of 32 bits takes
_DIFFERENCES = 2**17  # number of differences between two values of 16 bits, as they are coded
_EXPECTED = "'<encoding>; compressedDepth png' or '<encoding>; compressedDepth rvl'"


def decode(format: str, data: bytes, max_pixels: int = 2**31 - 1) -> npt.NDArray[Any]:
    """Depth image of a CompressedImage.

    Args:
        format: the field ``format`` of the message, such as ``16UC1; compressedDepth png``. Where it does not say how
            the image is compressed it is PNG, as older senders mean it.
        data: its field ``data``; anything with the buffer protocol.
        max_pixels: a larger image is refused before memory is taken for it.

    Returns:
        (H, W) uint16 steps (16UC1, mono16) or float32 metres with NaN for no measurement (32FC1), C-contiguous.

    Raises:
        MessageError: another format, damaged or too large, or PNG without Pillow installed.
    """
    encoding, codec = _parse_format(format)
    payload = memoryview(data).cast("B")
    if len(payload) <= _HEADER.size:
        raise MessageError(f"data: expected more than the {_HEADER.size} bytes of its header, got {len(payload)}")
    _, a, b = _HEADER.unpack_from(payload)
    metres = DEPTH_ENCODINGS[encoding] == "f4"
    if metres and not (np.isfinite(a) and a > 0.0 and np.isfinite(b)):
        raise MessageError(f"data: expected finite quantisation parameters, the first above 0, got {a:g} and {b:g}")
    read = _png if codec == "png" else _rvl
    steps = read(payload[_HEADER.size :], max_pixels)
    return _inverse_depth(steps, a, b) if metres else steps


def _parse_format(format: str) -> tuple[str, str]:
    """Encoding of the image, and ``png`` or ``rvl``."""
    encoding, separator, rest = format.partition(";")
    encoding, words = encoding.strip(), rest.split()
    if encoding not in DEPTH_ENCODINGS:
        raise MessageError(f"format: expected an encoding of {', '.join(DEPTH_ENCODINGS)} first, got {format!r}")
    if not separator or words == ["compressedDepth"]:
        return encoding, "png"
    if len(words) < 2 or words[0] != "compressedDepth" or words[1] not in ("png", "rvl"):
        raise MessageError(f"format: expected {_EXPECTED}, got {format!r}")
    return encoding, words[1]


def _inverse_depth(steps: npt.NDArray[np.uint16], a: float, b: float) -> npt.NDArray[np.float32]:
    """(H, W) float32 metres of inverse depths, in float32 as the senders count on it."""
    with np.errstate(all="ignore"):
        metres: npt.NDArray[np.float32] = np.float32(a) / (steps.astype(np.float32) - np.float32(b))
    metres[steps == 0] = np.nan
    return metres


def _check_size(width: int, height: int, max_pixels: int) -> None:
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise MessageError(f"data: expected an image of 1 to {LARGEST_SIDE} pixels a side, got {width} x {height}")
    if width * height > max_pixels:
        raise MessageError(f"data: expected at most bounds.max_rays = {max_pixels} pixels, got {width} x {height}")


def _png(payload: memoryview, max_pixels: int) -> npt.NDArray[np.uint16]:
    """(H, W) uint16 of a PNG with one channel of 16 bits."""
    if len(payload) < _PNG_START.size:
        raise MessageError(f"data: expected a PNG after the header, got {len(payload)} bytes")
    signature, _, chunk, width, height, bits, colour = _PNG_START.unpack_from(payload)
    if signature != _PNG_SIGNATURE or chunk != b"IHDR":
        raise MessageError(f"data: expected a PNG after the header, got bytes that begin {bytes(payload[:8])!r}")
    if (bits, colour) != (16, 0):
        raise MessageError(f"data: expected a PNG of 16 bit grey, got one of {bits} bits with colour type {colour}")
    _check_size(width, height, max_pixels)
    try:
        from PIL import Image
    except ImportError as error:
        raise MessageError("data: to read PNG, Pillow is needed: pip install 'shadow_tracer[compressed]'") from error
    try:
        with Image.open(io.BytesIO(payload), formats=("PNG",)) as image:
            steps = np.array(image)
    except Exception as error:  # of damaged data Pillow raises what its decoders happen to raise
        raise MessageError(f"data: the PNG is damaged: {type(error).__name__}: {error}") from error
    if steps.shape != (height, width):
        raise MessageError(f"data: the PNG is damaged: expected {width} x {height} pixels, got shape {steps.shape}")
    return steps.astype(np.uint16, copy=False)


def _rvl(payload: memoryview, max_pixels: int) -> npt.NDArray[np.uint16]:
    """(H, W) uint16 of RVL: a run of zeros, a run of differences, and so on; numbers of three bits a nibble."""
    if len(payload) < _RVL_START.size:
        raise MessageError(f"data: expected columns and rows in 8 bytes after the header, got {len(payload)} bytes")
    width, height = _RVL_START.unpack_from(payload)
    _check_size(width, height, max_pixels)
    pixels = width * height
    # A run of a pixel takes at most two numbers of its own and a difference: more bytes hold nothing.
    end = min(len(payload), _RVL_START.size + 4 * (pixels * 3 * _LONGEST_NUMBER // 8 + 1))
    numbers = _numbers(payload[_RVL_START.size : end])
    runs, used = _runs(numbers, pixels)
    zeros_and_others = runs.ravel()
    # Of the numbers, two tell of a run and then as many as it is long are differences.
    lengths = np.empty_like(zeros_and_others)
    lengths[0::2], lengths[1::2] = 2, runs[:, 1]
    kinds = np.tile(np.array([False, True]), len(runs))
    coded = numbers[:used][np.repeat(kinds, lengths)]
    if len(coded) and coded.max() >= _DIFFERENCES:
        raise MessageError("data: the RVL stream has a difference between pixels that 16 bits cannot have")
    differences = (coded >> 1) ^ -(coded & 1)
    steps = np.zeros(pixels, np.uint16)
    # Modulo 2**16, as the sender counts.
    steps[np.repeat(kinds, zeros_and_others)] = np.cumsum(differences, dtype=np.int64).astype(np.uint16)
    return steps.reshape(height, width)


def _numbers(payload: memoryview) -> npt.NDArray[np.int64]:
    """All numbers of an RVL stream; zeros that fill up its last word follow."""
    octets = np.frombuffer(payload[: len(payload) // 4 * 4], "<u4").astype(">u4").view(np.uint8)
    nibbles = np.empty(2 * len(octets), np.uint8)
    nibbles[0::2], nibbles[1::2] = octets >> 4, octets & 15
    ends = np.flatnonzero(nibbles < 8)  # the last nibble of each number
    starts = np.empty_like(ends)
    starts[:1], starts[1:] = 0, ends[:-1] + 1
    sizes = ends - starts
    numbers: npt.NDArray[np.int64] = (nibbles[starts] & 7).astype(np.int64)
    longer = np.flatnonzero(sizes >= 1)
    for place in range(1, _LONGEST_NUMBER):
        if not len(longer):
            break
        numbers[longer] |= (nibbles[starts[longer] + place] & 7).astype(np.int64) << (3 * place)
        longer = longer[sizes[longer] > place]
    numbers[longer] = 2**62  # too long for any number: no run can be of this length
    return numbers


def _runs(numbers: npt.NDArray[np.int64], pixels: int) -> tuple[npt.NDArray[np.int64], int]:
    """(N, 2) pixels without and with a value, run by run, and how many of the numbers that takes."""
    ahead = memoryview(numbers)
    found: list[int] = []
    place, left = 0, pixels
    while left:
        if place + 2 > len(ahead):
            raise MessageError(f"data: the RVL stream ends {left} pixels before the image does")
        zeros, others = ahead[place], ahead[place + 1]
        if zeros + others > left or zeros + others == 0:
            raise MessageError(f"data: the RVL stream has a run of {zeros} + {others} pixels where {left} are left")
        if others > len(ahead) - place - 2:
            raise MessageError(f"data: the RVL stream ends {left} pixels before the image does")
        found += (zeros, others)
        place, left = place + 2 + others, left - zeros - others
    return np.array(found, np.int64).reshape(-1, 2), place
