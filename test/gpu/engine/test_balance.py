# SPDX-License-Identifier: Apache-2.0
"""Bands of the image that take equally long: where cuts go for given times, and that nothing else changes."""

from __future__ import annotations

import threading
import time

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer
from shadow_tracer.gpu.engine.bands import Balance, image_bands

_BOUNDS = Bounds(max_triangles=4000, max_rays=65536, max_lights=1)
_CAMERA = Camera(256, 256, 200.0, 200.0, 127.5, 127.5)
_LAMP = PointLight("lamp", (0.3, -1.0, 0.5))


def _depth(step: int = 0) -> np.ndarray:
    return np.random.default_rng(step).uniform(3.5, 4.5, (256, 256)).astype(np.float32)


def _rows(cuts: list[tuple[int, int]], width: int = 256) -> list[int]:
    return [end // width for _, end in cuts[:-1]]


@pytest.mark.parametrize("bands", [2, 3, 8])
def test_cuts_settle_where_bands_take_equally_long(bands: int) -> None:
    """Work that grows downwards: row r takes r + 20."""
    balance, depth, work = Balance(bands), _depth(), np.arange(256) + 20.0
    spread = []
    for _ in range(60):
        cuts = balance.cut(depth, depth.size)
        assert cuts[0][0] == 0 and cuts[-1][1] == depth.size
        assert all(one[1] == other[0] for one, other in zip(cuts[:-1], cuts[1:], strict=True))
        times = [work[first // 256 : end // 256].sum() for first, end in cuts]
        spread.append(max(times) / np.mean(times))
        balance.learn(times)
    assert spread[0] > 1.3 and spread[-1] < 1.04 + 4 * 275.0 / (work.sum() / bands)  # cuts are at every fourth row
    assert len(set(spread[-20:])) == 1, "they rest once they are good enough"


@pytest.mark.parametrize("bands", [2, 3])
@pytest.mark.parametrize("where", [0.3, 0.45, 0.5, 0.7])
def test_a_few_rows_with_much_of_the_work_are_cut_through(where: float, bands: int) -> None:
    """A cut does not jump to and fro over them."""
    balance, depth = Balance(bands), _depth()
    row = np.arange(256) / 256
    work = np.where(abs(row - where) < 0.06, 30.0, 1.0)
    spread = []
    for _ in range(48):
        cuts = balance.cut(depth, depth.size)
        times = [work[first // 256 : end // 256].sum() for first, end in cuts]
        spread.append(max(times) / np.mean(times))
        balance.learn(times)
    assert spread[-1] < 1.04 + 4 * 30.0 / (work.sum() / bands) and len(set(spread[-12:])) == 1


def test_what_was_found_of_another_image_misleads_nobody() -> None:
    """The work moves to the other half, again and again: the first cut after that goes there."""
    balance, depth = Balance(2), _depth()
    row = np.arange(256) / 256
    for where in (0.3, 0.7, 0.2, 0.8, 0.5):
        work = np.where(abs(row - where) < 0.06, 30.0, 1.0)
        cuts = [_rows(balance.cut(depth, depth.size))[0]]
        for _ in range(40):
            balance.learn([work[: cuts[-1]].sum(), work[cuts[-1] :].sum()])
            cuts.append(_rows(balance.cut(depth, depth.size))[0])
        moved = [cut for cut in cuts if cut != cuts[0]]
        assert (moved[0] > cuts[0]) == (where * 256 > cuts[0])
        assert len(set(cuts[-8:])) == 1 and abs(work[: cuts[-1]].sum() - 0.5 * work.sum()) <= 4 * 30.0


def test_the_first_moves_are_quick_and_further_ones_take_a_median() -> None:
    balance, depth = Balance(2), _depth()

    def row() -> int:
        return _rows(balance.cut(depth, depth.size))[0]

    assert row() == 128
    balance.learn([3.0, 2.0])
    first = row()
    balance.learn([3.0, 2.0])
    second = row()
    assert 128 > first > second
    for times in ([2.0, 2.01], [9.0, 2.0], [2.0, 2.01]):  # one of them an accident
        balance.learn(times)
        assert row() == second
    balance.learn([2.0, 2.0])
    assert row() == second
    for _ in range(4):
        assert row() == second
        balance.learn([2.0, 3.0])
    assert row() > second


def test_no_cut_goes_far_at_once() -> None:
    balance, depth = Balance(2), _depth()
    balance.cut(depth, depth.size)
    balance.learn([1.0, 1000.0])
    assert 128 < _rows(balance.cut(depth, depth.size))[0] <= 128 + 0.15 * 256 + 4


def test_a_difference_that_is_not_worth_it_moves_nothing() -> None:
    balance, depth = Balance(2), _depth()
    before = balance.cut(depth, depth.size)
    for _ in range(20):
        balance.learn([1.03, 0.97])
    assert balance.cut(depth, depth.size) == before


def test_room_comes_first() -> None:
    """Where there is room for an even band only, cuts stay, and do not jump when there is room again."""
    balance, depth = Balance(2), _depth()
    for _ in range(12):
        cuts = balance.cut(depth, depth.size // 2)
        assert _rows(cuts) == [128]
        balance.learn([2.0, 1.0])
    assert _rows(balance.cut(depth, depth.size))[0] >= 128 - 0.15 * 256 - 4


@pytest.mark.parametrize("at", [[0.5], [0.2, 0.9], [0.25, 0.5, 0.75]])
def test_where_cuts_are_is_told(at: list[float]) -> None:
    """In parts of the measurements above them, one row of sixty-four or less beside where they were wanted."""
    depth = _depth()
    depth[:100] = 0.0
    cuts, edges = image_bands(depth, at, depth.size)
    assert np.allclose(edges, at, atol=1.5 / 40)
    above = [(depth[:row] > 0).mean(axis=1).sum() + 0.1 * row for row in _rows(cuts)]
    assert np.allclose(edges, np.array(above) / (156 + 25.6), atol=1e-6)


def test_bands_lie_in_the_image_one_after_the_other() -> None:
    """Wherever cuts are wanted and measurements are, in images that rows are sampled of unevenly."""
    rng, empty = np.random.default_rng(11), 0
    for _ in range(3000):
        height, width = (int(n) for n in rng.choice([1, 2, 3, 37, 64, 65, 100, 251, 480, 512], 2))
        depth = np.zeros((height, width), np.float32)
        first, last = sorted(rng.integers(0, height + 1, 2))
        depth[first:last] = 2.0
        bands = int(rng.integers(1, 9))
        room = int(-(-depth.size // bands) * rng.choice([1.0, 1.25, 4.0, 9.0])) + 1
        cuts, edges = image_bands(depth, np.sort(rng.choice([0.0, 1.0, rng.random()], bands - 1)), room)
        assert cuts[0][0] == 0 and cuts[-1][1] == depth.size and len(cuts) == bands == len(edges) + 1
        assert all(one[1] == other[0] for one, other in zip(cuts[:-1], cuts[1:], strict=True))
        assert all(0 <= end - begin <= room for begin, end in cuts)
        assert all(0.0 <= one <= other <= 1.0 for one, other in zip([0.0, *edges], [*edges, 1.0], strict=True))
        empty += any(begin == end for begin, end in cuts)
    assert empty > 100


@pytest.mark.parametrize("threads", [2, 16])
def test_measurements_below_the_last_cut_there_can_be(threads: int) -> None:
    """Seven rows are sampled as one, and 480 are not a multiple: a cut after the last of them is no cut."""
    bounds = Bounds(max_triangles=4000, max_rays=2 * 480 * 640, max_lights=1)
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    depth = np.full((480, 640), np.nan, np.float32)
    depth[473:] = 4.0
    found = []
    for count in (1, threads):
        tracer = ShadowTracer("light_grid", "packed", device="cpu", bounds=bounds, threads=count)
        tracer.scene.put("ball", *geometry.icosphere(2, 0.8, (0.0, 1.5, 2.5)))
        bands = len(probe.bands(tracer))
        for balance in probe.balances(tracer).values():
            probe.cut_at(balance, np.sqrt(np.arange(1, bands) / bands))
        found.append([tracer.trace(depth, camera, [_LAMP]).state("lamp") for _ in range(2)])
    assert np.array_equal(found[0], found[1]) and {0, 3} <= set(np.unique(found[0]))


def test_a_band_without_pixels_gets_some_again() -> None:
    """Eight bands of an image whose work is in its first rows, then of one whose work is everywhere."""
    balance, depth = Balance(8), _depth()
    for work in (np.r_[np.full(4, 1000.0), np.full(252, 0.01)], np.ones(256)):
        for _ in range(160):
            cuts = balance.cut(depth, depth.size)
            balance.learn([work[first // 256 : end // 256].sum() for first, end in cuts])
    times = [end - first for first, end in balance.cut(depth, depth.size)]
    assert max(times) <= 1.2 * np.mean(times)


@pytest.mark.wide
@pytest.mark.parametrize(
    "names", ["light_grid/packed", "cone_hierarchy/linear", "brute_force/filtered", "mesh_bvh/refit"]
)
def test_moving_cuts_change_no_bit(names: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every frame is cut elsewhere, at one side of the image or the other."""
    tracer = ShadowTracer(*names.split("/"), device="cpu", bounds=_BOUNDS, threads=2)
    one = ShadowTracer(*names.split("/"), device="cpu", bounds=_BOUNDS, threads=1)
    rng, counts = np.random.default_rng(3), set()
    vertices, triangles = geometry.icosphere(3, 0.8, (0.0, 0.0, 2.5))
    for balance in probe.balances(tracer).values():
        monkeypatch.setattr(balance, "learn", lambda times, it=balance: probe.cut_at(it, rng.uniform(0, 1, 1)))
    for step in range(10):
        for each in (tracer, one):
            each.scene.put("ball", vertices * (1.0 + 0.01 * step), triangles)
        depth = _depth(step)
        found, expected = (each.trace(depth, _CAMERA, [_LAMP]).state("lamp") for each in (tracer, one))
        assert np.array_equal(found, expected) and {0, 1} <= set(np.unique(found))
        counts.add(tuple(band.samples.count for band in probe.bands(tracer)))
    assert len(counts) > 5 and max(max(pair) for pair in counts) <= 0.625 * 65536


@pytest.mark.wide
def test_the_same_image_is_cut_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else its rays would be made again. What a frame with kept rays takes teaches nothing."""
    tracer = ShadowTracer("light_grid", "packed", device="cpu", bounds=_BOUNDS, threads=2)
    tracer.scene.put("ball", *geometry.icosphere(3, 0.8, (0.0, 0.0, 2.5)))
    (balance,) = probe.balances(tracer).values()
    for step in range(3):
        tracer.trace(_depth(step), _CAMERA, [_LAMP])
    learned, again = [], []
    monkeypatch.setattr(balance, "learn", learned.append)
    depth = _depth(9)
    for part in (0.4, 0.42, 0.44):
        probe.cut_at(balance, [part])
        tracer.trace(depth, _CAMERA, [_LAMP])
        again.append(probe.rays_again(tracer))
    assert again == [[False, False], [True, True], [True, True]]
    assert len(learned) == 1 and len(learned[0]) == 2 and all(seconds > 0.0 for seconds in learned[0])


@pytest.mark.wide
def test_each_pipeline_of_auto_has_cuts_of_its_own() -> None:
    tracer = ShadowTracer("auto", device="cpu", bounds=_BOUNDS, threads=2)
    balances = probe.balances(tracer)
    assert set(balances) == {names for names, count in probe.band_counts(tracer).items() if count == 2}
    assert len({id(balance) for balance in balances.values()}) == len(balances) >= 2
    single = ShadowTracer("light_grid", "spherical", device="cpu", bounds=_BOUNDS, threads=2)
    assert probe.balances(single) == {}


@pytest.mark.wide
def test_who_is_to_forget_cuts_evenly() -> None:
    tracer = ShadowTracer("light_grid", "packed", device="cpu", bounds=_BOUNDS, threads=2)
    for part, count in ((0.4, None), (None, 128 * 256)):
        if part is None:
            probe.forget(tracer, "")
        for balance in probe.balances(tracer).values() if part else ():
            probe.cut_at(balance, [part])
        tracer.trace(_depth(), _CAMERA, [_LAMP])
        rows = [band.samples.count for band in probe.bands(tracer)]
        assert rows[0] < 110 * 256 if count is None else rows == [count, count]


@pytest.mark.wide
def test_bands_are_judged_by_the_time_of_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread that waits for a processor has no more work than others. Here each looks at a clock that its band's rows
    move."""
    tracer = ShadowTracer("light_grid", "packed", device="cpu", bounds=_BOUNDS, threads=2)
    tracer.scene.put("ball", *geometry.icosphere(3, 0.8, (0.0, 0.0, 2.5)))
    tracer.trace(_depth(), _CAMERA, [_LAMP])
    (balance,) = probe.balances(tracer).values()
    learned: list[list[float]] = []
    monkeypatch.setattr(balance, "learn", learned.append)
    clocks: dict[int, float] = {}

    def look() -> float:
        me = threading.get_ident()
        clocks[me] = clocks.get(me, 0.0) + (3.0 if me == threading.main_thread().ident else 5.0)
        return clocks[me]

    monkeypatch.setattr(time, "thread_time", look)
    tracer.trace(_depth(1), _CAMERA, [_LAMP])
    assert learned == [[3.0, 5.0]]
