# SPDX-License-Identifier: Apache-2.0
"""Which messages brought the markers that are in force at a time, so that whoever starts there reads no others."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.layouts import Layouts
from shadow_tracer.ros.wire.markers import PREFIX, marker_changes
from shadow_tracer.ros.wire.parts import Part, PartError

_RUNS = 64  # stretches of a bag: looking each of them up takes time too
_GAP = 8  # messages that are read though they are not wanted, rather than to look up another stretch
_EVER = np.iinfo(np.int64).max
_NO_VERTICES, _NO_TRIANGLES = np.empty((0, 3)), np.empty((0, 3), np.int32)


@dataclass
class MarkerLives:
    """Markers from when they came to when they were replaced, deleted or over, by times of the log [ns].

    Attributes:
        rows: (N, 3) when, until when, and number of the key.
        keys: of parts.
        most: triangles that all markers had together at a time, at most.
    """

    rows: Any = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    keys: list[str] = field(default_factory=list)
    most: int = 0

    def at(self, time: int) -> tuple[set[str], set[int]]:
        """Keys of those that are in force before the messages of a time are taken, and when they came."""
        there = self.rows[(self.rows[:, 0] < time) & (self.rows[:, 1] >= time)]
        return {self.keys[key] for key in there[:, 2].tolist()}, set(there[:, 0].tolist())


class MarkerLedger:
    """Takes messages with markers in the order of the log.

    Args:
        max_triangles: more are refused, as by whoever plays them.
    """

    def __init__(self, max_triangles: int) -> None:
        self._layouts = Layouts()
        self._max_triangles = max_triangles
        self._parts: dict[str, Part] = {}  # without their meshes
        self._since: dict[str, tuple[int, int]] = {}  # when they came, and their triangles
        self._numbers: dict[str, int] = {}
        self._rows: list[tuple[int, int, int]] = []
        self._triangles = self._most = 0

    def take(self, topic: str, data: bytes, time: int) -> list[Any]:
        """Take a message of ``mesh_marker`` or ``mesh_markers``. Returns its markers; none if it is refused."""
        self._end([key for key, part in self._parts.items() if part.expires is not None and part.expires <= time], time)
        try:
            if topic == "mesh_marker":
                messages = [self._layouts.marker(data, self._max_triangles)]
            else:
                messages = self._layouts.markers(data, self._max_triangles)
            changes = marker_changes(messages, self._parts, time, topic)
        except PartError:  # counted when it is played
            return []
        gone = [*self._parts] if changes.clear is not None else list(changes.remove)
        self._end([*gone, *(part.key for part in changes.put)], time)
        for part in changes.put:
            self._parts[part.key] = replace(part, vertices=_NO_VERTICES, triangles=_NO_TRIANGLES)
            self._since[part.key] = time, len(part.triangles)
            self._triangles += len(part.triangles)
        self._most = max(self._most, self._triangles)
        return messages

    def _end(self, keys: list[str], time: int) -> None:
        for key in keys:
            if self._parts.pop(key, None) is not None:
                self._note(key, time)

    def _note(self, key: str, until: int) -> None:
        since, triangles = self._since.pop(key)
        self._triangles -= triangles
        self._rows.append((since, until, self._numbers.setdefault(key, len(self._numbers))))

    def finish(self) -> MarkerLives:
        """All of it, when the last message is taken."""
        most = self._most
        self._end([*self._parts], int(_EVER))
        return MarkerLives(np.array(self._rows, np.int64).reshape(-1, 3), list(self._numbers), most)


def is_marker(key: str) -> bool:
    """Whether a part came as a marker."""
    return key.startswith(PREFIX)


def runs(times: Any, wanted: set[int]) -> list[tuple[int, int]]:
    """First and last time of stretches in which all wanted times are, few in number and with little between them.

    Args:
        times: (N,) of all messages, in order; every wanted one among them.
        wanted: of those to be read.
    """
    places = np.searchsorted(times, np.array(sorted(wanted), np.int64))
    if not len(places):
        return []
    gaps = np.diff(places)
    least = max(_GAP, int(np.sort(gaps)[-_RUNS]) if len(gaps) >= _RUNS else 0)
    ends = np.flatnonzero(gaps > least)
    first, last = places[np.append(0, ends + 1)], places[np.append(ends, len(places) - 1)]
    return list(zip(times[first].tolist(), times[last].tolist(), strict=True))
