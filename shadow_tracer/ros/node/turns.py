# SPDX-License-Identifier: Apache-2.0
"""Waiting in a callback of rclpy while its executor does its other work. No ROS here."""

from __future__ import annotations

import time
from collections.abc import Generator

_BREATH = 0.002  # rclpy resumes a waiting coroutine at every turn of the executor; this keeps the turns from spinning


class Turn:
    """Awaited, lets the executor do its other work once. The callback needs a reentrant group: a coroutine that waits
    keeps everything else of its group from being executed."""

    def __await__(self) -> Generator[None, None, None]:
        time.sleep(_BREATH)
        yield
