# SPDX-License-Identifier: Apache-2.0
"""Who is next among several cameras, and which images are wanted of one that sends too many."""

from __future__ import annotations

import numpy as np
import pytest

from shadow_tracer.ros.cameras.fair_turns import FairTurns
from shadow_tracer.ros.cameras.rate_limit import RateLimit


def test_who_was_answered_longest_ago_is_next() -> None:
    turns = FairTurns(["a", "b", "c"])
    assert turns.order() == ("a", "b", "c")
    turns.answered("a")
    turns.answered("c")
    assert turns.order() == ("b", "a", "c")
    turns.answered("c")
    assert turns.order() == ("b", "a", "c")


def test_nobody_waits_for_more_than_one_turn_of_each_other() -> None:
    rng, turns, waited = np.random.default_rng(1), FairTurns("abcd"), dict.fromkeys("abcd", 0)
    for _ in range(1000):
        there = [name for name in turns.order() if rng.random() < 0.6]
        for name in waited:
            waited[name] = waited[name] + 1 if name in there[1:] else 0
        if there:
            turns.answered(there[0])
        assert max(waited.values()) <= 3


def passed(limit: RateLimit, times: np.ndarray) -> np.ndarray:
    """Times at which one passes."""
    return np.array([time for time in times.tolist() if limit.wants(time)])


@pytest.mark.parametrize(
    ("sent", "rate", "expected"), [(30, 15, 15), (30, 30, 30), (30, 60, 30), (20, 15, 15), (30, 7, 7)]
)
def test_so_many_pass_in_a_second_whatever_the_jitter(sent: int, rate: float, expected: float) -> None:
    rng = np.random.default_rng(2)
    times = 100.0 + np.arange(20 * sent) / sent + rng.uniform(-0.003, 0.003, 20 * sent)
    limit = RateLimit(rate)
    assert abs(len(passed(limit, times)) / 20.0 - expected) < 0.3
    assert limit.left_out == len(times) - round(len(passed(RateLimit(rate), times)))


def test_what_was_missed_is_not_made_up_for() -> None:
    limit = RateLimit(1.0)
    assert passed(limit, np.array([0.0, 0.1, 50.0, 50.1, 50.2, 50.9, 51.0])).tolist() == [0.0, 50.0, 50.9]


def test_zero_is_all_and_a_rate_may_change() -> None:
    limit = RateLimit()
    assert len(passed(limit, np.zeros(10))) == 10 and limit.left_out == 0
    limit.rate = 0.001
    assert passed(limit, np.array([1.0, 2.0, 3.0])).tolist() == [1.0]
    limit.rate = 10.0
    assert passed(limit, np.array([3.01, 3.2, 3.205])).tolist() == [3.2]  # not in a thousand seconds
    limit.rate = 0.0
    assert limit.wants(3.22)
