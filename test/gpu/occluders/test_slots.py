# SPDX-License-Identifier: Apache-2.0
"""Where parts lie: gaps are filled again, and nothing lies twice."""

from __future__ import annotations

import numpy as np

from shadow_tracer.gpu.occluders.changes import Changed, History
from shadow_tracer.gpu.occluders.slots import Room, blocks, few, merged


def test_the_first_gap_that_is_large_enough_is_taken() -> None:
    room = Room(1, 20, [(5, 10), (1, 3), (12, 12), (12, 15)])
    assert [room.take(count) for count in (3, 2, 0, 2, 4, 1, 1)] == [15, 3, 1, 10, None, 18, 19]
    assert room.take(1) is None and room.take(0) == 1
    assert Room(0, 0).take(1) is None


def test_what_is_free_of_some_ranges() -> None:
    room = Room(0, 20, [(0, 5), (8, 12)])
    assert room.within([(3, 10), (11, 14)], 20) == ((5, 8), (12, 14))
    assert room.within([(3, 10), (11, 14)], 13) == ((5, 8), (12, 13))
    assert room.within([(0, 20)], 8) == ((5, 8),) and room.within([(0, 5)], 20) == ()


def test_nothing_lies_twice() -> None:
    """Against a bit for each element."""
    rng, size = np.random.default_rng(1), 60
    for _ in range(200):
        ends = np.sort(rng.integers(0, size, 8))
        taken = [(int(first), int(last)) for first, last in ends.reshape(-1, 2)]
        free = np.ones(size, bool)
        for first, last in taken:
            free[first:last] = False
        room = Room(0, size, (taken[k] for k in rng.permutation(4)))
        for count in rng.integers(1, 12, 12):
            fits = np.convolve(free, np.ones(count, int), "valid") == count
            place = room.take(int(count))
            assert place == (int(np.argmax(fits)) if fits.any() else None)
            if place is not None:
                free[place : place + count] = False


def test_ranges() -> None:
    assert merged([(5, 7), (1, 3), (3, 4), (9, 9), (6, 8)]) == ((1, 4), (5, 8))
    assert few(((0, 1), (2, 3), (9, 10), (30, 31)), 2) == ((0, 10), (30, 31))
    assert few(((0, 1), (2, 3)), 1) == ((0, 3),) and few((), 1) == ()
    assert blocks([(0, 1), (127, 129), (640, 641)], 128, 500) == ((0, 2),)
    assert blocks([(300, 400)], 128, 300) == ((2, 3),), "it begins in the last block"
    assert blocks([(256, 400)], 128, 256) == ()


def test_a_history_knows_the_last_revisions() -> None:
    history = History()
    assert history.since(0) is None
    for number in range(1, 101):
        history.add(number, ((number, number + 1),), ((2 * number, 2 * number + 1),))
    assert history.since(100) == Changed() and not history.since(100)
    assert history.since(98) == Changed(((99, 101),), ((198, 199), (200, 201)))
    assert history.since(36) == Changed(((37, 101),), history.since(36).vertices)  # type: ignore[union-attr]
    assert history.since(35) is None
    history.clear()
    assert history.since(100) is None
