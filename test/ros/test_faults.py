# SPDX-License-Identifier: Apache-2.0
"""What goes wrong around a node, in the scenarios that no other test has. All of them are in benchmark/faults.py."""

from __future__ import annotations

import pytest

from benchmark import faults

pytestmark = pytest.mark.slow


def test_publishers_may_be_killed_and_come_back() -> None:
    assert faults.publisher_killed_and_restarted(places=(0.0, 0.1), silence=False)


def test_damaged_compressed_depth_is_refused_by_name() -> None:
    assert faults.damaged_compressed_depth()


def test_a_lens_that_cannot_be_understood_is_refused_until_it_can() -> None:
    assert faults.lens_misread()


def test_nodes_in_namespaces_do_not_hear_each_other() -> None:
    assert faults.several_cameras(count=2)


def test_signals_at_random_times_leave_nothing_behind() -> None:
    assert faults.signals_at_random_times(count=2, seed=3, latest=2.0)
