# SPDX-License-Identifier: Apache-2.0
"""Surfaces that come, go, move and lose positions under suns, lamps and lights with size, frame after unlike frame on
one tracer; and memory that nobody has written. The same as ``test_sequences.py`` has for meshes."""

from __future__ import annotations

import numpy as np
import probe
import pytest
import sequences
from poison import BYTES, Poison
from sequences import ROOMY, TIGHT

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators.height_field import charts
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

pytestmark = [probe.in_both_forms, pytest.mark.parametrize("pipeline", ["height_field", "geometry_image"])]


@pytest.fixture(autouse=True)
def _small_surfaces_and_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts, "_FEWEST_QUADS", 1)
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 64)


def _tracer(pipeline: str, bounds: Bounds = ROOMY, threads: int = 1) -> ShadowTracer:
    return ShadowTracer(pipeline, device="cpu", bounds=bounds, threads=threads)


def _run(tracer: ShadowTracer, steps: tuple[sequences.Step, ...]) -> int:
    """Trace them all; returns in how many a sun was swept last."""
    swept = 0
    for number, step in enumerate(steps):
        assert sequences.differing(tracer, step) == 0, number
        swept += tracer.pipeline == "height_field" and probe.charts(tracer)[1] >= 0
    return swept


@pytest.mark.parametrize("threads", [1, 3])
def test_unlike_frames_one_after_the_other(pipeline: str, threads: int) -> None:
    steps = sequences.sequence(threads, 14, terrain=True)
    states = np.concatenate([step.states.reshape(-1) & 7 for step in steps])
    assert (np.bincount(states, minlength=2)[:2] > 500).all()
    swept = _run(_tracer(pipeline, (ROOMY, TIGHT)[threads % 2], threads), steps)
    assert pipeline != "height_field" or 2 < swept < 13


def test_first_frames_of_fresh_tracers(pipeline: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What lies in the memory they are given is anything."""
    for number, step in enumerate(sequences.sequence(4, 10, fresh=True, terrain=True)):
        with monkeypatch.context() as patch:
            Poison(patch, BYTES[number % len(BYTES)])
            tracer = _tracer(pipeline, threads=1 + number % 2)
            assert sequences.differing(tracer, step) == 0, number


@pytest.mark.parametrize("byte", BYTES)
def test_memory_that_nobody_has_written(pipeline: str, byte: int, monkeypatch: pytest.MonkeyPatch) -> None:
    Poison(monkeypatch, byte)
    _run(_tracer(pipeline, threads=2), sequences.sequence(5 + BYTES.index(byte), 6, terrain=True))


def test_nothing_is_read_that_the_frame_has_not_written(pipeline: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where everything is new in a frame, all of the tracer's memory is poisoned before it."""
    poison, tracer = Poison(monkeypatch, 0xCD), _tracer(pipeline, threads=2)
    for number, step in enumerate(sequences.sequence(4, 10, fresh=True, terrain=True)):
        assert poison.fill(BYTES[number % len(BYTES)]) > 1_000_000
        assert sequences.differing(tracer, step) == 0, number
