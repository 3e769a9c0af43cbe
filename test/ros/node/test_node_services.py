# SPDX-License-Identifier: Apache-2.0
"""The service ~/self_test: every pipeline on a built-in scene, while the node goes on. For ~/clear_meshes see
test_node_meshes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.srv import SelfTest
from harness import NodeProcess, Rig, plate, wall
from std_srvs.srv import Trigger

from shadow_tracer import available_pipelines
from shadow_tracer.ros.diagnostics import DEVICE, ERROR, OK, PROCESSING
from shadow_tracer.ros.node import tracer_host
from shadow_tracer.self_test import Result

SERVICE = "shadow_tracer/self_test"


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig() as made:
        made.send_mesh(*plate())
        yield made


def test_every_pipeline_passes_and_frames_go_on(rig: Rig) -> None:
    before = rig.trace(wall())
    response = rig.call(SelfTest, SERVICE, timeout=120.0)
    assert response.passed == b"\x01" and response.id == "shadow_tracer"
    tested = {status.name.removeprefix("shadow_tracer: self test: ") for status in response.status}
    assert tested == {f"{name}/{variants[0]}" for name, variants in available_pipelines().items()}
    for status in response.status:
        values = {pair.key: pair.value for pair in status.values}
        assert status.level == OK and status.hardware_id == "shadow_tracer" and status.message
        assert values["pixels that differ"] == "0" and float(values["seconds"]) >= 0.0
    np.testing.assert_array_equal(rig.trace(wall()), before)
    assert rig.value(PROCESSING, "faults") == "0"


def test_a_disagreement_is_said(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    results = [
        Result("brute_force", "filtered", True, 0, 0.1, ""),
        Result("light_grid", "packed", False, 7, 0.2, ""),
        Result("mesh_bvh", "refit", False, 99, 0.3, "the driver is gone"),
    ]
    monkeypatch.setattr(tracer_host, "run", lambda *_, **__: results)
    response = rig.call(SelfTest, SERVICE)
    assert response.passed == b"\x00"
    assert [status.level for status in response.status] == [OK, ERROR, ERROR]
    assert response.status[1].name.endswith("light_grid/packed") and response.status[1].values[0].value == "7"
    assert response.status[2].message == "the driver is gone"
    assert not np.array_equal(rig.trace(wall()), np.zeros((48, 64)))


def test_a_test_that_cannot_be_made_has_not_passed(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_device: str, **_: Any) -> Any:
        raise MemoryError("no room for a second tracer")

    monkeypatch.setattr(tracer_host, "run", broken)
    response = rig.call(SelfTest, SERVICE)
    assert response.passed == b"\x00"
    assert [(status.level, status.message) for status in response.status] == [(ERROR, "no room for a second tracer")]
    rig.trace(wall())
    rig.wait_status(PROCESSING, OK)


def test_meanwhile_the_node_answers_and_frames_wait(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    before = rig.trace(wall())
    gate, entered = threading.Event(), []

    def slow(device: str, **_: Any) -> list[Result]:
        entered.append(device)
        assert gate.wait(60.0)
        return [Result("light_grid", "packed", True, 0, 0.1, "")]

    monkeypatch.setattr(tracer_host, "run", slow)
    first, second = rig.request(SelfTest, SERVICE), rig.request(SelfTest, SERVICE)
    rig.wait_status(DEVICE, OK, "self test for")
    stamps = [rig.send_frame(wall()) for _ in range(3)]
    rig.until(lambda: rig.value(PROCESSING, "waiting") == "1")
    assert rig.call(Trigger, "shadow_tracer/clear_meshes").success
    assert rig.set(bias__constant=0.03) == "" and rig.set(pipeline="mesh_bvh") == ""
    assert not first.done() and not second.done() and len(rig.masks[""]) == 1
    gate.set()
    rig.until(lambda: first.done() and second.done())
    assert first.result().passed == second.result().passed == b"\x01" and entered == ["cpu", "cpu"]
    after = rig.mask_of(stamps[-1])
    assert (after.ravel()[1:] == 255).all() and (before == 0).any()
    rig.wait_status(DEVICE, OK, "mesh_bvh/refit on cpu")
    assert rig.value(PROCESSING, "faults") == "0"


def test_a_node_that_starts_tests_itself_when_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    warm_up = tracer_host.ShadowTracer.warm_up
    held = lambda self, **what: gate.wait(60.0) and warm_up(self, **what)  # noqa: E731
    monkeypatch.setattr(tracer_host.ShadowTracer, "warm_up", held)
    monkeypatch.setattr(tracer_host, "run", lambda *_, **__: [Result("light_grid", "packed", True, 0, 0.1, "")])
    with Rig(start=False) as rig:
        rig.start(wait=False)
        future = rig.request(SelfTest, SERVICE)
        rig.wait_status(DEVICE, OK, "starting up")
        assert not future.done()
        gate.set()
        rig.until(future.done)
        assert future.result().passed == b"\x01"
        rig.until(lambda: rig.node and rig.node.ready)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_signal_amid_a_self_test_ends_the_node_cleanly(delay: float) -> None:
    with NodeProcess() as process, Rig(start=False) as rig:
        process.wait_for("Ready")
        rig.request(SelfTest, SERVICE)
        rig.settle(delay)
        assert process.stop(signal.SIGINT) == (0, "")


def test_clear_meshes_says_what_went_wrong(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_now: int) -> int:
        raise RuntimeError("impossible")

    monkeypatch.setattr(rig.core.inputs.meshes, "clear", broken)
    response = rig.call(Trigger, "shadow_tracer/clear_meshes")
    assert not response.success and response.message == "impossible"
    rig.wait_status(PROCESSING, ERROR, "RuntimeError: impossible; the node goes on")
