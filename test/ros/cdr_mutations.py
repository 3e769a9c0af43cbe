# SPDX-License-Identifier: Apache-2.0
"""Broken bytes for the parsers of raw messages: good ones, changed at random. No ROS here."""

from __future__ import annotations

import struct

import numpy as np


def mutate(rng: np.random.Generator, data: bytearray) -> bytearray:
    """One change: a byte, a cut, an insertion, a number of 32 bits (any, or a small one), garbage behind the header."""
    where = int(rng.integers(0, len(data))) if data else 0
    kind = int(rng.integers(0, 6))
    if kind == 0 and data:
        data[where] = int(rng.integers(0, 256))
    elif kind == 1:
        data = data[:where]
    elif kind == 2:
        data[where:where] = rng.bytes(int(rng.integers(1, 32)))
    elif kind == 3 and len(data) >= 8:
        struct.pack_into("<I", data, 4 * int(rng.integers(0, len(data) // 4)), int(rng.integers(0, 2**32)))
    elif kind == 4 and len(data) >= 8:
        struct.pack_into("<I", data, 4 * int(rng.integers(0, len(data) // 4)), int(rng.integers(0, 64)))
    elif kind == 5:
        data = bytearray(bytes(data[:4]) + rng.bytes(int(rng.integers(0, 600))))
    return data
