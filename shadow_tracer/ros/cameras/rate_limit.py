# SPDX-License-Identifier: Apache-2.0
"""Which images of a camera are wanted if it sends more than are to be answered. No ROS here."""

from __future__ import annotations

_SLACK = 0.4  # parts of a period: an image that comes so much before it is due is in time


class RateLimit:
    """Lets so many in a second pass. An image that comes late does not move those after it; what was missed for longer
    than a period is not made up for.

    Attributes:
        rate: the most in a second [Hz]; 0 is all.
        left_out: how many did not pass.
    """

    def __init__(self, rate: float = 0.0) -> None:
        self.rate = rate
        self.left_out = 0
        self._due: float | None = None

    def wants(self, now: float) -> bool:
        """Whether the one that comes at the steady time ``now`` [s] passes."""
        if self.rate <= 0.0:
            self._due = None
            return True
        period = 1.0 / self.rate
        latest = now + (1.0 + _SLACK) * period  # later it is only by a rate that was lower, and is over
        due = now if self._due is None else min(self._due, latest)
        if now + _SLACK * period < due:
            self.left_out += 1
            self._due = due
            return False
        self._due = due + period if now <= due + period else now + period
        return True
