# SPDX-License-Identifier: Apache-2.0
"""What a row of the parameter table is, and values checked against it. No ROS here."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

BOOL, INTEGER, DOUBLE, STRING = "bool", "integer", "double", "string"
STRINGS, DOUBLES = "string array", "double array"


NAME = re.compile(r"[A-Za-z](?:_?[A-Za-z0-9])*")  # of a light or a camera
NAME_TEXT = "letters, digits and single underscores, a letter first"
_WIDEST_SLIDER = 1000.0  # a screen has some thousand pixels: beyond, each is more than a unit


class ParameterError(ValueError):
    """A parameter has a value it cannot have. The message starts with its name, then what is allowed and what came."""


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Attributes:
        name: full name, or the key within ``lights.<name>`` or ``cameras.<name>``.
        type: one of the type words above.
        default: value if nothing is set.
        description: meaning, one or two sentences.
        unit: unit of the value, "" if it has none.
        low, high: inclusive range of a number.
        allowed: the words a string may be; empty if it is free.
        length: number of values of a double array.
        pattern, pattern_text: what a string must look like, and that in words.
        read_only: why it cannot change at run time; "" if it can.
    """

    name: str
    type: str
    default: Any
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    allowed: tuple[str, ...] = ()
    length: int = 0
    pattern: re.Pattern[str] | None = None
    pattern_text: str = ""
    read_only: str = ""

    @property
    def constraint(self) -> str:
        """The allowed values in words, unit included; "" if every value of the type is allowed."""
        unit = f" {self.unit}" if self.unit else ""
        each = f" [{self.unit}]" if self.unit else ""
        if self.allowed:
            return ", ".join(word or '""' for word in self.allowed)
        if self.low is not None:
            return f"{_number(self.low)} to {_number(self.high)}{unit}"
        if self.length:
            return f"{self.length} numbers{each}"
        return self.pattern_text

    @property
    def slider(self) -> tuple[float, float] | None:
        """The range that tools are given, which make a slider of it; None where no hand could set a value on one."""
        if self.low is None or self.high is None or self.read_only or self.high - self.low > _WIDEST_SLIDER:
            return None
        return self.low, self.high


def _number(value: Any) -> str:
    return "pi" if value == math.pi else f"{value:.12g}"


def convert(name: str, row: Parameter, value: Any) -> Any:
    """The value in the type of its row: integers become doubles where doubles are wanted, arrays become tuples.

    Raises:
        ParameterError: wrong type, out of range, not finite, not an allowed word.
    """
    if row.type == BOOL:
        good = isinstance(value, bool)
    elif row.type == STRING:
        good = isinstance(value, str)
        if good and row.allowed:
            good = value in row.allowed
        elif good and row.pattern:
            good = row.pattern.fullmatch(value) is not None
    elif row.type == STRINGS:
        items = _sequence(value)
        good = items is not None and all(isinstance(item, str) for item in items)
        value = value if items is None else items
    elif row.type == DOUBLES:
        items = _sequence(value)
        good = items is not None and len(items) == row.length and all(_is_number(item) for item in items)
        value = value if items is None else tuple(float(item) for item in items) if good else items
    else:
        good = _is_number(value) if row.type == DOUBLE else _is_integer(value)
        good = good and (row.low is None or row.high is None or row.low <= value <= row.high)
        value = float(value) if good and row.type == DOUBLE else value
    if not good:
        wanted = f"{row.type} ({row.constraint})" if row.constraint else row.type
        raise ParameterError(f"{name}: expected {wanted}, got {value!r}")
    return value


def convert_names(parameter: str, row: Parameter, value: Any, reserved: Sequence[str]) -> tuple[str, ...]:
    """The names in a list of names; a lone empty string, the ROS way to write an empty list, is none.

    Args:
        reserved: names that are not allowed though they look like names.

    Raises:
        ParameterError: not a list of valid, different names.
    """
    names: tuple[str, ...] = convert(parameter, row, value)
    if names == ("",):
        return ()
    for name in names:
        if not NAME.fullmatch(name) or name in reserved:
            raise ParameterError(f"{parameter}: expected names of {row.constraint}, got {name!r}")
    if len(set(names)) != len(names):
        raise ParameterError(f"{parameter}: expected different names, got {list(names)}")
    return names


def _sequence(value: Any) -> tuple[Any, ...] | None:
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        return None
    return tuple(value)


def _is_integer(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return _is_integer(value) or (isinstance(value, (float, np.floating)) and math.isfinite(value))
