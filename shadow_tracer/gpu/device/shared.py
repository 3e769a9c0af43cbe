# SPDX-License-Identifier: Apache-2.0
"""Things that several hold and one makes."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar
from weakref import WeakValueDictionary

_Made = TypeVar("_Made")


class Shared:
    """What is made once for all that need it: one of a kind, which lives as long as somebody holds it."""

    def __init__(self) -> None:
        self._made: WeakValueDictionary[Hashable, Any] = WeakValueDictionary()

    def take(self, kind: Hashable, make: Callable[[], _Made]) -> _Made:
        """The one of its kind, made when nobody has it."""
        made = self._made.get(kind)
        if made is None:
            self._made[kind] = made = make()
        found: _Made = made
        return found

    def find(self, kind: type[_Made]) -> _Made | None:
        """The one of its kind, None if nobody has it."""
        return self._made.get(kind)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(made.nbytes() for made in self._made.values())
