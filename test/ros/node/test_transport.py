# SPDX-License-Identifier: Apache-2.0
"""Gaps in the numbers of messages: lost by the transport, or passed over by a busy node. No ROS is needed here."""

from __future__ import annotations

import pytest

from shadow_tracer.ros.node.transport import LossMeter


def fed(numbers: list[int], period: float = 0.1, size: int = 64) -> LossMeter:
    """A meter after messages with these numbers, sent every ``period`` seconds since 0 by one publisher."""
    meter = LossMeter(size)
    for number in numbers:
        meter.note(number, number * period, alone=True)
    return meter


def test_nothing_is_lost_where_numbers_follow_each_other() -> None:
    meter = fed(list(range(5, 35)))
    assert meter.skipped == 0
    assert meter.lost_share(3.5, 20.0) == (0.0, pytest.approx(10.0))


def test_gaps_are_counted_and_shared_among_what_was_sent() -> None:
    meter = fed(list(range(1, 62, 3)))  # two of three are missing
    assert meter.skipped == 40
    share, rate = meter.lost_share(6.2, 20.0)
    assert share == pytest.approx(2 / 3) and rate == pytest.approx(10.0)


def test_only_the_last_messages_count_for_the_share() -> None:
    meter = fed([*range(1, 62, 3), *range(62, 80)], size=16)
    assert meter.skipped == 40
    assert meter.lost_share(8.0, 20.0)[0] == 0.0


def test_a_busy_node_overwrites_its_queue_which_is_no_loss() -> None:
    meter = fed(list(range(1, 62, 3)))
    assert meter.lost_share(6.2, 69.0)[0] == pytest.approx(2 / 3)  # 0.69 of the time at 10 Hz
    assert meter.lost_share(6.2, 71.0) == (0.0, pytest.approx(10.0))


def test_few_or_old_messages_say_nothing() -> None:
    few = list(range(1, 19, 2))
    assert len(few) == 9 and fed(few).lost_share(2.0, 0.0) == (0.0, 0.0)
    meter = fed([*few, 19])
    assert meter.lost_share(4.8, 0.0)[0] == pytest.approx(0.5)
    assert meter.lost_share(5.0, 0.0) == (0.0, 0.0)
    burst = LossMeter()
    for number in range(1, 40, 2):
        burst.note(number, 1.0, alone=True)
    assert burst.lost_share(1.0, 0.0) == (0.0, 0.0)  # at once: there is no rate


def test_a_publisher_that_began_anew_has_lost_nothing() -> None:
    meter = fed(list(range(100, 120)))
    for number in range(1, 21):
        meter.note(number, 12.0 + 0.1 * number, alone=True)
    assert meter.skipped == 0 and meter.lost_share(14.1, 0.0) == (0.0, pytest.approx(10.0))


def test_several_publishers_and_unknown_numbers_tell_nothing() -> None:
    meter = LossMeter()
    for k in range(40):
        meter.note(1 + 7 * k, 0.1 * k, alone=False)
    assert meter.skipped == 0 and meter.lost_share(4.0, 0.0) == (0.0, 0.0)
    for k in range(40):
        meter.note(0, 0.1 * k, alone=True)  # the middleware gives no numbers
    assert meter.skipped == 0 and meter.lost_share(4.0, 0.0) == (0.0, 0.0)
    meter.note(50, 5.0, alone=True)
    meter.note(60, 5.1, alone=False)
    meter.note(70, 5.2, alone=True)  # one publisher again: the gap across the others is not counted
    assert meter.skipped == 0
    meter.note(72, 5.3, alone=True)
    assert meter.skipped == 1
