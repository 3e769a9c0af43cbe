# SPDX-License-Identifier: Apache-2.0
"""What is made once and used in several places."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar
from weakref import WeakValueDictionary

_Made = TypeVar("_Made")


class Shared:
    """What is made once for all that need it: one of a kind, which lives as long as something holds it."""

    def __init__(self) -> None:
        self._made: WeakValueDictionary[Hashable, Any] = WeakValueDictionary()

    def take(self, kind: Hashable, make: Callable[[], _Made]) -> _Made:
        """The one of its kind, made when there is none."""
        made = self._made.get(kind)
        if made is None:
            self._made[kind] = made = make()
        found: _Made = made
        return found

    def find(self, kind: type[_Made]) -> _Made | None:
        """The one of its kind, None if there is none."""
        return self._made.get(kind)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(made.nbytes() for made in self._made.values())
