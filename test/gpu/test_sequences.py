# SPDX-License-Identifier: Apache-2.0
"""Sequences of unlike frames on one tracer, first frames of fresh tracers, and memory that nobody has written: nothing
of another frame, and nothing that lay there before, answers for a sample."""

from __future__ import annotations

import numpy as np
import probe
import pytest
import sequences
from poison import BYTES, Poison
from sequences import ROOMY, TIGHT

from shadow_tracer import Bounds, ShadowTracer, available_pipelines
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_VARIANTS = [(name, variant) for name, variants in available_pipelines().items() for variant in variants]
_DEFAULTS = [(name, variants[0]) for name, variants in available_pipelines().items()]
_CASES = [(names, probe.USUAL) for names in _VARIANTS]
_CASES += [(names, probe.CUDA) for names in _DEFAULTS if names[0] in ("light_grid", "cone_hierarchy", "brute_force")]
_CASES += [(names, probe.EVERY_PAIR) for names in (("light_grid", "packed"), ("auto", "measured"))]


def _each(cases: list[tuple[tuple[str, str], str]]) -> pytest.MarkDecorator:
    """The inner loop takes the default variants in the usual form."""
    marked = [
        pytest.param(
            *(names, form),
            id="/".join(names) if form == probe.USUAL else f"{'/'.join(names)}-{form}",
            marks=[] if names in _DEFAULTS and form == probe.USUAL else [pytest.mark.slow],
        )
        for names, form in cases
    ]
    return pytest.mark.parametrize(("names", "kernel_form"), marked, indirect=["kernel_form"])


# The inner loop takes the first sequence.
_SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]
# Those that follow the papers closely, or decide everything exactly, are slow: two sequences are enough for them.
_SLOWEST = "cone_hierarchy/spheres", "cone_hierarchy/precise", "brute_force/float64", "light_grid/spherical", "bsp"
_QUICK_CASES = [case for case in _CASES if not "/".join(case[0]).startswith(_SLOWEST)]
_SHARED = [("light_grid", "packed"), ("cone_hierarchy", "linear"), ("brute_force", "filtered"), ("auto", "measured")]
_PACKED, _LINEAR = ("light_grid", "packed"), ("cone_hierarchy", "linear")
_FIRST = 50


@pytest.fixture(autouse=True)
def _small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight threads have work in a few hundred samples."""
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 64)


def _tracer(names: tuple[str, str], bounds: Bounds = ROOMY, threads: int = 1) -> ShadowTracer:
    return ShadowTracer(*names, device="cpu", bounds=bounds, threads=threads)


def _wrong(tracer: ShadowTracer, steps: tuple[sequences.Step, ...]) -> dict[int, int]:
    wrong = {number: sequences.differing(tracer, step) for number, step in enumerate(steps)}
    return {number: count for number, count in wrong.items() if count}


def test_sequences_hold_what_they_promise() -> None:
    """Light and shadow, one sample and all, images and points."""
    steps = [step for seed in (1, 2, 3) for step in sequences.sequence(seed, 24)]
    sizes = {step.states.shape[1] for step in steps}
    assert min(sizes) == 1 and max(sizes) == sequences.MAX_RAYS
    assert sum(step.points is None for step in steps) > 10 < sum(step.points is not None for step in steps)
    counts = np.sum([np.bincount(step.states.reshape(-1) & 7, minlength=5) for step in steps], axis=0)
    assert (counts > 1000).all()


@pytest.mark.parametrize(("bounds", "seed"), [(ROOMY, 1), (TIGHT, 2)], ids=["roomy-1", "tight-2"])
@_each(_CASES)
def test_unlike_frames_one_after_the_other(names: tuple[str, str], bounds: Bounds, seed: int) -> None:
    assert _wrong(_tracer(names, bounds), sequences.sequence(seed, 24)) == {}


@pytest.mark.parametrize(
    ("bounds", "seed"),
    [(ROOMY, 2), (ROOMY, 3), (TIGHT, 1), (TIGHT, 3)],
    ids=["roomy-2", "roomy-3", "tight-1", "tight-3"],
)
@_each(_QUICK_CASES)
@pytest.mark.slow
def test_more_unlike_frames(names: tuple[str, str], bounds: Bounds, seed: int) -> None:
    assert _wrong(_tracer(names, bounds), sequences.sequence(seed, 24)) == {}


@pytest.mark.parametrize("seed", _SEEDS)
@pytest.mark.parametrize("threads", [2, 3, 4, 8])
@pytest.mark.parametrize("names", _SHARED, ids="/".join)
@pytest.mark.slow
def test_unlike_frames_by_several_threads(names: tuple[str, str], threads: int, seed: int) -> None:
    tracer = _tracer(names, (ROOMY, TIGHT)[seed % 2], threads)
    assert tracer.threads == threads
    assert _wrong(tracer, sequences.sequence(seed, 24)) == {}


@pytest.mark.parametrize("seed", _SEEDS)
@pytest.mark.parametrize(
    ("threads", "kernel_form"), [(1, probe.USUAL), (3, probe.USUAL), (1, probe.CUDA)], indirect=["kernel_form"]
)
def test_pipelines_that_take_turns_in_one_tracer(threads: int, seed: int) -> None:
    """Another pipeline every few frames, and frames traced by a second one in between."""
    rng, tracer = np.random.default_rng(seed), _tracer(("light_grid", "packed"), threads=threads)
    for number, step in enumerate(sequences.sequence(seed, 24)):
        if rng.random() < 0.5:
            tracer.select(*_VARIANTS[rng.integers(len(_VARIANTS))])
        assert sequences.differing(tracer, step) == 0, (number, tracer.pipeline, tracer.variant)
        if step.points is None and rng.random() < 0.5:
            assert tracer.verify(step.depth, step.camera, step.lights, step.bias) == 0, number


@pytest.mark.parametrize("seed", _SEEDS)
@probe.in_forms("names", [_PACKED], [_PACKED, _LINEAR])
def test_unlike_frames_recorded(names: tuple[str, str], seed: int) -> None:
    """Each kind of frame twice more, so that it is recorded and replayed."""
    tracer = ShadowTracer(*names, device="cpu", bounds=(TIGHT, ROOMY)[seed % 2], graphs=True)
    for number, step in enumerate(sequences.sequence(seed, 24)):
        assert sequences.differing(tracer, step) == 0, number
        for _ in range(2):
            assert np.array_equal(step.trace(tracer), step.states), number


@_each(_CASES)
def test_first_frames_of_fresh_tracers(names: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies in the memory they are given is anything; threads in turn, where there are several."""
    steps, wrong = sequences.sequence(4, _FIRST, fresh=True), {}
    for number, step in enumerate(steps):
        threads = (1, 2, 3, 4, 8)[number // len(BYTES) % 5] if names in _SHARED else 1
        with monkeypatch.context() as patch:
            Poison(patch, BYTES[number % len(BYTES)])
            tracer = _tracer(names, threads=threads)
            wrong[number] = sequences.differing(tracer, step)
    assert not any(wrong.values()), wrong


@pytest.mark.parametrize("byte", BYTES)
@_each(_CASES)
def test_memory_that_nobody_has_written(names: tuple[str, str], byte: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """What frames leave unwritten stays poisoned from the allocation on."""
    Poison(monkeypatch, byte)
    steps = sequences.sequence(5 + BYTES.index(byte), 10)
    assert _wrong(_tracer(names, threads=1 + BYTES.index(byte)), steps) == {}


@_each(_CASES)
def test_nothing_is_read_that_the_frame_has_not_written(
    names: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where everything is new in a frame, all of the tracer's memory is poisoned before it, of each sort in turn."""
    poison = Poison(monkeypatch, 0xCD)
    tracer, wrong = _tracer(names, threads=2), {}
    for number, step in enumerate(sequences.sequence(4, 12, fresh=True)):
        assert poison.fill(BYTES[number % len(BYTES)]) > 1_000_000
        wrong[number] = sequences.differing(tracer, step)
    assert not any(wrong.values()), wrong


_COUNTING = [
    case for case in _CASES if case[0][0] not in ("mesh_bvh", "height_field", "geometry_image", "auto")
]  # hints and choices go on


@_each(_COUNTING)
@pytest.mark.slow
def test_a_frame_takes_what_it_takes_a_fresh_tracer(names: tuple[str, str]) -> None:
    """Where everything is new: the same counters, so that nothing of an earlier frame was even looked at."""
    tracer = _tracer(names)
    for number, step in enumerate(sequences.sequence(6, 16, fresh=True)):
        counters = []
        for each in (tracer, _tracer(names)):
            for change in step.changes:
                change(each.scene)
            probe.forget_anchor(each)
            counters.append(step.counters(each))
        assert counters[0] == counters[1], number
