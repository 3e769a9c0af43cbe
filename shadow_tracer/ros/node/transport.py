# SPDX-License-Identifier: Apache-2.0
"""Messages that the transport loses, told from those that a busy node passes over. No ROS here."""

from __future__ import annotations

from collections import deque

LARGE = 500_000  # bytes; stock Fast DDS loses larger messages that are sent best effort


class LossMeter:
    """Counts gaps in the numbers that a publisher gives its messages.

    Attributes:
        skipped: messages that were sent and did not arrive, in all.
    """

    def __init__(self, size: int = 64) -> None:
        self.skipped = 0
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=size)

    def note(self, number: int, now: float, alone: bool) -> None:
        """A message has arrived.

        Args:
            number: its number, 0 if unknown.
            now: steady time [s].
            alone: exactly one publisher sends; with several their numbers mix and tell nothing.
        """
        last = self._arrivals[-1][1] if self._arrivals else 0
        if not alone or number <= last:  # another publisher, or one that began again
            self._arrivals.clear()
        elif self._arrivals:
            self.skipped += number - last - 1
        if alone and number:
            self._arrivals.append((now, number))

    def lost_share(self, now: float, busy_ms: float) -> tuple[float, float]:
        """Share of the last messages that the transport lost, and the rate at which they were sent [Hz].

        Args:
            now: steady time [s].
            busy_ms: mean time that the node spends on one of them; if that does not leave it idle, the queue of depth 1
                was overwritten, which is no loss, and the share is 0.
        """
        if len(self._arrivals) < 10:
            return 0.0, 0.0
        (first, low), (last, high) = self._arrivals[0], self._arrivals[-1]
        if last <= first or now - last > 3.0:
            return 0.0, 0.0
        rate = (high - low) / (last - first)
        if busy_ms * 1e-3 * rate > 0.7:
            return 0.0, rate
        return 1.0 - (len(self._arrivals) - 1) / (high - low), rate
