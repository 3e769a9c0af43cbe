# SPDX-License-Identifier: Apache-2.0
"""Which of several cameras is answered next. No ROS here."""

from __future__ import annotations

from collections.abc import Iterable


class FairTurns:
    """The camera that was answered longest ago comes first, so that none starves however much the others send.

    Args:
        names: the cameras; at first in this order.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._order = list(names)

    def order(self) -> tuple[str, ...]:
        """All of them, the next first."""
        return tuple(self._order)

    def answered(self, name: str) -> None:
        """This one has had its turn."""
        self._order.remove(name)
        self._order.append(name)
