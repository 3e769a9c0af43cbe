# SPDX-License-Identifier: Apache-2.0
"""Where parts lie in a buffer: each in a range that it keeps, with gaps where parts have gone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Range = tuple[int, int]  # first, and behind the last
Ranges = tuple[Range, ...]

# Ranges that are worked on one by one: each is a launch or two.
_MOST = 8


class Room:
    """What is free of a buffer, from ``begin`` to ``end``, if the ranges ``taken`` are not."""

    def __init__(self, begin: int, end: int, taken: Iterable[Range] = ()) -> None:
        self._begin = begin
        self._free: list[Range] = []
        for first, last in sorted(each for each in taken if each[0] < each[1]):
            if begin < first:
                self._free.append((begin, first))
            begin = last
        if begin < end:
            self._free.append((begin, end))

    def take(self, count: int) -> int | None:
        """The first place where ``count`` elements fit, which are free no longer; None if there is no such place."""
        if count == 0:
            return self._begin
        for number, (first, last) in enumerate(self._free):
            if last - first > count:
                self._free[number] = first + count, last
                return first
            if last - first == count:
                del self._free[number]
                return first
        return None

    def within(self, ranges: Iterable[Range], end: int) -> Ranges:
        """What is free of ``ranges``, up to ``end``."""
        found = []
        for first, last in ranges:
            for begin, behind in self._free:
                low, high = max(first, begin), min(last, behind, end)
                if low < high:
                    found.append((low, high))
        return merged(found)


def merged(ranges: Iterable[Range]) -> Ranges:
    """The same elements in ascending ranges that do not touch; empty ranges are dropped."""
    found: list[Range] = []
    for first, last in sorted(ranges):
        if first >= last:
            continue
        if found and first <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], last)
        else:
            found.append((first, last))
    return tuple(found)


def few(ranges: Ranges, most: int = _MOST) -> Ranges:
    """At most so many ranges that hold merged ones: those with the least between them become one."""
    if len(ranges) <= most:
        return ranges
    between = [after[0] - before[1] for before, after in zip(ranges, ranges[1:], strict=False)]
    cuts = sorted(sorted(range(len(between)), key=between.__getitem__, reverse=True)[: most - 1])
    firsts, lasts = [0, *(cut + 1 for cut in cuts)], [*cuts, len(ranges) - 1]
    return tuple((ranges[first][0], ranges[last][1]) for first, last in zip(firsts, lasts, strict=True))


def blocks(ranges: Sequence[Range], size: int, count: int) -> Ranges:
    """The blocks of ``size`` elements that ``ranges`` touch, of those that hold the first ``count`` elements."""
    every = -(-count // size)
    return merged((first // size, min(-(-last // size), every)) for first, last in ranges)
