# SPDX-License-Identifier: Apache-2.0
"""Timing and health as diagnostic_msgs, and the small meters behind them. What they say is decided in :mod:`health`.

ROS is imported where a message is made, and nowhere else.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"  # as in diagnostic_msgs/DiagnosticStatus

DEPTH, MESH, TRANSFORMS, DEVICE, PROCESSING = "input depth", "input mesh", "transforms", "device", "processing"


_LONGEST = 600


def cut(text: str) -> str:
    """At most 600 characters of a text: it may quote a message, in which a name may have any length."""
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 80]} ... {text[-70:]}"


READ_FIRST = 120  # characters of a message that `ros2 topic echo` and most viewers show


def cure_first(text: str) -> str:
    """A message ``what is wrong; what helps`` so that what helps, after the last ``;``, is among what is read first."""
    wrong, _, cure = text.rpartition("; ")
    return f"{cure} - {wrong}" if wrong and len(text) > READ_FIRST else text


class Missing(Exception):
    """Something a frame needs is not there: its mask says unknown.

    Args:
        status: the diagnostics status that tells about it, one of the five names above.
        text: what is missing, and the command or setting that helps.
        wait: it may still come; ask again until the frame has waited long enough.
        level: WARN or ERROR.
    """

    def __init__(self, status: str, text: str, wait: bool = True, level: bytes = WARN) -> None:
        super().__init__(cut(text))
        self.status = status
        self.text = cut(text)
        self.wait = wait
        self.level = level


class Complaint:
    """Counts refusals and remembers the last; ``recent`` for a while, so that a single one can be read."""

    def __init__(self, remember: float = 5.0) -> None:
        self.count = 0
        self.text = ""
        self._remember = remember
        self._when = -np.inf

    def add(self, text: str, now: float) -> None:
        """Note a refusal at the steady time ``now`` [s]."""
        self.count += 1
        self.text = cut(text)
        self._when = now

    def recent(self, now: float) -> bool:
        """True within ``remember`` seconds after the last refusal."""
        return now - self._when <= self._remember


class RateMeter:
    """Rate and age of something that arrives, on a steady clock, over the last arrivals."""

    def __init__(self, size: int = 32) -> None:
        self.count = 0
        self._times: deque[float] = deque(maxlen=size)

    def tick(self, now: float) -> None:
        """Note an arrival at the steady time ``now`` [s]."""
        self.count += 1
        self._times.append(now)

    def age(self, now: float) -> float:
        """Seconds since the last arrival; infinity before the first."""
        return now - self._times[-1] if self._times else np.inf

    def rate(self, now: float) -> float:
        """Arrivals per second; 0 before the second one and after three seconds of silence."""
        if len(self._times) < 2 or self.age(now) > 3.0:
            return 0.0
        span = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / span if span > 0.0 else 0.0


class Window:
    """Mean, 95th percentile and maximum of the last values of a series."""

    def __init__(self, size: int = 256) -> None:
        self._values: deque[float] = deque(maxlen=size)

    def add(self, value: float) -> None:
        """Append a value."""
        self._values.append(value)

    def mean(self) -> float:
        """Mean of the values, 0 if there is none."""
        return sum(self._values) / len(self._values) if self._values else 0.0

    def summary(self) -> str:
        """``mean / 95 % / max``, or "-" if there is nothing yet."""
        return self.summary_of([self])

    @staticmethod
    def summary_of(windows: Iterable[Window]) -> str:
        """The same of several series together."""
        values = np.array([value for window in windows for value in window._values])
        if not len(values):
            return "-"
        return f"{values.mean():.1f} / {np.percentile(values, 95):.1f} / {values.max():.1f}"


def age_ms(stamp: int, now_ns: int) -> float | None:
    """How old something with a stamp is [ms], 0 if the stamp is ahead of the clock; None while the clock stands at 0:
    use_sim_time is set and no /clock has come.

    Args:
        stamp: its stamp [ns].
        now_ns: time of the node's clock [ns].
    """
    return max(now_ns - stamp, 0) * 1e-6 if now_ns else None


def status(name: str, level: bytes, text: str, values: Mapping[str, Any], hardware_id: str) -> DiagnosticStatus:
    """A DiagnosticStatus; values are written with ``str``."""
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=text, hardware_id=hardware_id, values=pairs)


def outcome(missing: Missing | None) -> tuple[bytes, str]:
    """Level and message of ``~/timing``: whether the frame was traced, or why not."""
    return (OK, "traced") if missing is None else (missing.level, f"unknown: {missing.text}")


def timing_values(stages: Mapping[str, float], numbers: Mapping[str, Any]) -> dict[str, str]:
    """The key-value pairs of ``~/timing``.

    Args:
        stages: stage -> milliseconds; written as ``<stage> [ms]``.
        numbers: counters, sizes; written under their own names.
    """
    values = {f"{name} [ms]": f"{value:.3f}" for name, value in stages.items()}
    return values | {key: str(n) for key, n in numbers.items()}


def timing(
    node: str,
    hardware_id: str,
    stamp: Any,
    missing: Missing | None,
    stages: Mapping[str, float],
    numbers: Mapping[str, Any],
) -> DiagnosticArray:
    """The message of ``~/timing`` for one frame.

    Args:
        node: name of the node.
        hardware_id: device that traced.
        stamp: stamp of the depth image, so that the message can be joined with its mask.
        missing: why the mask says unknown; None if the frame was traced.
        stages, numbers: see :func:`timing_values`.
    """
    from diagnostic_msgs.msg import DiagnosticArray

    values = timing_values(stages, numbers)
    array = DiagnosticArray(status=[status(f"{node}: timing", *outcome(missing), values, hardware_id)])
    array.header.stamp = stamp
    return array
