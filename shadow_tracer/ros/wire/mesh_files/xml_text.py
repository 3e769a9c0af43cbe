# SPDX-License-Identifier: Apache-2.0
"""XML without its name spaces, and the numbers that stand in it."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.mesh_files.content import FloatArray, IntArray, ReadError, parse_numbers

Element = ElementTree.Element


def parse(data: bytes) -> Element:
    """The root. Tags have no name space; comments are gone, also those within numbers."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # of an encoding that is not known
        raise ReadError(f"it is no XML: {error}; write the file again") from error
    for element in root.iter():
        if isinstance(element.tag, str):
            element.tag = element.tag.rpartition("}")[2]
    return root


def floats(text: str | None, what: str, count: int | None = None) -> FloatArray:
    """Numbers of a text, ``count`` of them if that is given."""
    return _numbers(text, np.float64, what, count)


def integers(text: str | None, what: str) -> IntArray:
    """Whole numbers of a text."""
    return _numbers(text, np.int64, what, None)


def _numbers(text: str | None, dtype: Any, what: str, count: int | None) -> npt.NDArray[Any]:
    try:
        numbers = parse_numbers((text or "").split(), dtype)
    except (ValueError, OverflowError) as error:
        raise ReadError(f"{what}: expected numbers: {error}") from error
    if count is not None and len(numbers) != count:
        raise ReadError(f"{what}: expected {count} numbers, got {len(numbers)}")
    return numbers
