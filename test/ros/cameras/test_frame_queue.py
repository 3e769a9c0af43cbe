# SPDX-License-Identifier: Apache-2.0
"""Frames that wait, and the small meters of diagnostics. No ROS is needed here."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shadow_tracer.ros.cameras.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.diagnostics import Complaint, RateMeter, Window


def message(stamp: int) -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=stamp), frame_id="camera"))


def frame(stamp: int) -> WaitingFrame:
    return WaitingFrame(message(stamp), np.ones((2, 2), np.float32), stamp, 0.0)


def test_taking_a_frame_drops_those_before_it() -> None:
    queue = FrameQueue()
    frames = [frame(stamp) for stamp in range(queue.CAPACITY + 2)]
    for item in frames:
        queue.put(item)
    assert list(queue.candidates()) == frames[:1:-1] and queue.dropped == 2
    queue.take(frames[-2])
    assert list(queue.candidates()) == [frames[-1]] and queue.dropped == 1 + queue.CAPACITY - 1
    queue.put(frame(99))
    before = queue.dropped
    queue.keep_newest()
    assert len(queue) == 1 and queue.dropped == before + 1
    queue.clear()
    assert len(queue) == 0 and queue.dropped == before + 2


def test_every_frame_in_order() -> None:
    queue = FrameQueue()
    queue.every = True
    frames = [frame(stamp) for stamp in range(2 * queue.CAPACITY)]
    for item in frames:
        queue.put(item)
    queue.keep_newest()
    taken = []
    while len(queue):
        (item,) = queue.candidates()
        taken.append(item)
        queue.take(item)
    assert taken == frames and queue.dropped == 0


def test_meters() -> None:
    rate = RateMeter()
    assert rate.rate(0.0) == 0.0 and rate.age(0.0) == np.inf
    for k in range(11):
        rate.tick(k * 0.1)
    assert rate.rate(1.0) == pytest.approx(10.0) and rate.age(1.5) == pytest.approx(0.5)
    assert rate.rate(9.0) == 0.0 and rate.count == 11
    complaint = Complaint(remember=2.0)
    assert not complaint.recent(0.0)
    complaint.add("no", 1.0)
    assert complaint.recent(3.0) and not complaint.recent(3.1) and complaint.count == 1
    window = Window()
    assert window.summary() == "-"
    window.add(2.0)
    assert window.summary() == "2.0 / 2.0 / 2.0"
