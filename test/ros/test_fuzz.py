# SPDX-License-Identifier: Apache-2.0
"""Some hundred messages that no honest publisher sends, on every input. The long form is benchmark/fuzz_node.py."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from rclpy.logging import LoggingSeverity, set_logger_level

from benchmark.fuzz_messages import INPUTS, Input, any_bytes, mutated
from benchmark.fuzz_node import fuzz, robust_slope

MESSAGES = 180


@pytest.fixture(autouse=True)
def _log_as_before() -> Iterator[None]:
    """The program silences the node, which would last for all tests of this process."""
    yield
    set_logger_level("shadow_tracer", LoggingSeverity.UNSET)


@pytest.mark.parametrize("tried", INPUTS, ids=lambda tried: tried.name.replace(" ", "_"))
@pytest.mark.slow
def test_whatever_comes_the_last_good_state_stays(tried: Input) -> None:
    result = fuzz(tried, MESSAGES, seed=5, every=60, judge_memory=False)
    assert not result.wrong
    assert result.messages == MESSAGES == result.refused + result.accepted
    assert result.refused > MESSAGES // 5 and result.checks == 4


def test_the_messages_are_what_they_are_called() -> None:
    """Bytes that are the same every time, differ from each other, and are cut one byte later each time."""
    raw = [tried for tried in INPUTS if isinstance(tried.good(0)[0], bytes)]
    assert [tried.name for tried in raw] == ["mesh", "mesh_marker", "mesh_markers"]
    for tried in raw:
        made = [_payloads(tried, random.Random(2), 900) for _ in range(2)]
        assert made[0] == made[1] and len(set(made[0])) > 400
        good = tried.good(0)[-1]
        assert {len(payload) for payload in made[0] if good.startswith(payload)} >= set(range(20)), tried.name
    rng = random.Random(1)
    assert mutated(rng, b"") == b"" and len({any_bytes(rng) for _ in range(100)}) > 80


def _payloads(tried: Input, rng: random.Random, count: int) -> list[bytes]:
    made = [tried.make(rng, number) for number in range(count)]
    return [message.payload for message in made]


def test_the_slope_is_not_moved_by_outliers() -> None:
    times = list(range(100))
    sizes = [1000.0 + 3.0 * t for t in times]
    sizes[10], sizes[50] = 1e9, 0.0
    assert robust_slope(times, sizes) == pytest.approx(3.0)
    assert robust_slope([1], [5]) == 0.0
