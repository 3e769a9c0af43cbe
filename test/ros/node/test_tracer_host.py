# SPDX-License-Identifier: Apache-2.0
"""The thread that makes and changes the tracer: what fails leaves the node with what it had. No ROS here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Bounds, Camera, PointLight
from shadow_tracer.gpu.engine import frame as frame_tracer
from shadow_tracer.ros.node import tracer_host
from shadow_tracer.ros.node.tracer_host import Outcome, TracerHost


def _settings(pipeline: str = "light_grid", threads: int = 1) -> Any:
    bounds = Bounds(max_triangles=100, max_rays=65536, max_lights=1, queue_capacity=1024, grid_entries=1024)
    return SimpleNamespace(
        pipeline=pipeline, variant="", tracer_device="cpu", bounds=bounds, threads=threads, verify_every=0
    )


class _Host:
    """A host, and how its jobs end."""

    def __init__(self) -> None:
        self._ended = threading.Event()
        self.host = TracerHost(self._ended.set)
        self._outcomes: list[Outcome] = []

    def do(self, job: Callable[..., None], *arguments: Any) -> Outcome:
        """Do a job of the host and wait for its outcome."""
        self._ended.clear()
        job(*arguments, self._outcomes.append)
        assert self._ended.wait(60.0)
        self.host.collect()
        return self._outcomes.pop()


def test_a_selection_that_fails_leaves_what_was_there(monkeypatch: pytest.MonkeyPatch) -> None:
    here = _Host()
    assert here.do(here.host.start, _settings()).error == ""
    tracer: Any = here.host.tracer

    def full(*_: Any) -> Any:
        raise MemoryError("no room for a second pipeline")

    with monkeypatch.context() as patch:
        patch.setattr(frame_tracer, "Band", full)
        outcome = here.do(here.host.select, _settings("brute_force"))
    assert outcome.error == "no room for a second pipeline"
    assert here.host.tracer is tracer and tracer.pipeline == "light_grid"
    depth, camera = np.full((4, 4), 3.0, np.float32), Camera(4, 4, 4.0, 4.0, 1.5, 1.5)
    assert (tracer.trace(depth, camera, [PointLight("lamp", (0, 0, 0))]).mask() == 255).all()
    assert here.do(here.host.select, _settings("brute_force")).error == "" and tracer.pipeline == "brute_force"


def test_the_self_test_has_the_threads_of_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    here = _Host()
    assert here.do(here.host.start, _settings(threads=3)).error == ""
    monkeypatch.setattr(tracer_host, "run", lambda device, threads: (device, threads))
    assert here.do(here.host.self_test).value == ("cpu", 3)
