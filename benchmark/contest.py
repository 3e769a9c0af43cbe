# SPDX-License-Identifier: Apache-2.0
"""The speed of each method on a case. They take turns, frame by frame, so that a busy minute of the machine meets all.
A frame during which another virtual machine had the processor does not count if there are others. Every answer is
compared, outside the clock; the time of one that was wrong is not given out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from case import Case, Wrong
from rivals import Contestant
from stolen import stolen

_MOST_WRONG = 1e-3  # part of the rays: peers work in float32; more than this is not the same question
_WARM_UP = 3  # rounds whose times are not kept: kernels are loaded, and bands balanced
_LOST = 0.05  # part of a frame's time: with more of it lost to others the frame is disturbed
_SHORT, _LEAST = 3, 0.2  # times the frames, as long as they take less than this part of the effort's seconds
_PATIENCE = 4  # times the effort, for frames that are not disturbed


@dataclass
class Timing:
    """Milliseconds of frames, of those that were disturbed, seconds spent, and the largest number of wrong rays in one
    of them."""

    calm: list[float] = field(default_factory=list)
    disturbed: list[float] = field(default_factory=list)
    spent: float = 0.0
    wrong: int = 0

    @property
    def times(self) -> list[float]:
        """Those that count."""
        return self.calm or self.disturbed

    @property
    def median(self) -> float:
        """Median of the frames."""
        return float(np.median(self.times))

    def enough(self, effort: Effort) -> bool:
        """Whether there need not be more."""
        if self.calm:
            # Short frames are at the mercy of single accidents: more of them cost nothing.
            few = len(self.calm) < _SHORT * effort.frames and sum(self.calm) < 1e3 * _LEAST * effort.seconds
            return (len(self.calm) >= effort.frames and not few) or self.spent > effort.seconds
        return bool(self.disturbed) and self.spent > _PATIENCE * effort.seconds


@dataclass(frozen=True)
class Effort:
    """How long to measure: frames per figure, and the seconds after which a figure gets no further ones."""

    frames: int = 5
    seconds: float = 1.0


def contest(case: Case, contestants: Sequence[Contestant], effort: Effort, static: bool = True) -> list[dict[str, Any]]:
    """A row per contestant, best first; without ``static`` only what is measured with the mesh moving.

    Raises:
        Wrong: a mask of ours is wrong.
    """
    moving = _rounds(case, contestants, "dynamic", effort)
    notes = {contestant.name: contestant.notes() for contestant in contestants}
    still: dict[str, Timing] = {}
    if static:
        for contestant in contestants:
            contestant.settle()
        still = _rounds(case, contestants, "static", effort)
    rows = []
    for contestant in contestants:
        timings = {"dynamic": moving[contestant.name]}
        if static:
            timings["static"] = still[contestant.name]
        rows.append(_row(case, contestant, timings) | notes[contestant.name])
    return sorted(_with_ratios(rows, case.rays), key=lambda row: row["dynamic ms"] or np.inf)


def _row(case: Case, contestant: Contestant, timings: dict[str, Timing]) -> dict[str, Any]:
    wrong = max(timing.wrong for timing in timings.values())
    valid = wrong <= _MOST_WRONG * contestant.rays
    row: dict[str, Any] = {
        "view": case.view.name,
        "triangles": len(case.view.triangles),
        "rays": contestant.rays,
        "lights": len(case.lights),
        "in shadow": case.in_shadow,
        "method": contestant.name,
        "ours": contestant.exact,
        "builds": contestant.builds,
        "wrong rays": wrong,
        "frames": len(timings["dynamic"].times),
        "disturbed": sum(len(timing.disturbed) for timing in timings.values()),
    }
    for motion in ("dynamic", "static"):
        timing = timings.get(motion)
        row[f"{motion} ms"] = timing.median if timing and valid else None
        row[f"{motion} least ms"] = min(timing.times) if timing and valid else None
    return row


def _rounds(case: Case, contestants: Sequence[Contestant], motion: str, effort: Effort) -> dict[str, Timing]:
    timings = {contestant.name: Timing() for contestant in contestants}
    count = len(case.frames)
    for turn in range(_WARM_UP + _PATIENCE * effort.frames):
        frame = turn % count
        right = (case.dynamic if motion == "dynamic" else case.static)[frame]
        # Drawn anew each time: nobody always follows the one that leaves caches and clock worst, which has been seen to
        # take half as long again.
        for place in np.random.default_rng(turn).permutation(len(contestants)):
            contestant = contestants[place]
            timing = timings[contestant.name]
            if timing.enough(effort):
                continue
            lost, begin = stolen(), time.perf_counter()
            found = getattr(contestant, motion)(frame)
            seconds = time.perf_counter() - begin
            lost = stolen() - lost
            _judge(case, contestant, timing, frame, found, right)
            timing.spent += seconds
            # A warm-up frame that uses up the time is the measurement; the first only if it is far beyond.
            enough = effort.seconds if turn else _PATIENCE * effort.seconds
            if turn >= _WARM_UP or timing.spent > enough:
                (timing.disturbed if lost > _LOST * seconds else timing.calm).append(1e3 * seconds)
    return timings


def _judge(case: Case, contestant: Contestant, timing: Timing, frame: int, found: Any, right: np.ndarray) -> None:
    wrong = contestant.wrong(frame, found, right)
    if wrong and contestant.exact:
        raise Wrong(f"{case.view.name}: {contestant.name} is wrong for {wrong} rays of frame {frame}")
    timing.wrong = max(timing.wrong, wrong)


def _with_ratios(rows: list[dict[str, Any]], rays: int) -> list[dict[str, Any]]:
    """Add how often our time goes into the best peer's, with its build ("dynamic") or its query alone ("static")."""
    peers = [row for row in rows if not row["ours"]]
    built = min((row["dynamic ms"] for row in peers if row["builds"] and row["dynamic ms"]), default=None)
    asked = min((row["static ms"] for row in peers if row["static ms"]), default=None)
    for row in rows:
        whole = row["ours"] and row["rays"] == rays
        row["dynamic ratio"] = built / row["dynamic ms"] if whole and built else None
        row["static ratio"] = asked / row["static ms"] if whole and asked else None
    return rows
