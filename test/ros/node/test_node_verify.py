# SPDX-License-Identifier: Apache-2.0
"""verify_every: every so manieth frame is traced by a second pipeline, and a disagreement does not go unnoticed."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import pytest
from harness import Rig, plate, wall

from shadow_tracer import ShadowTracer
from shadow_tracer.ros.diagnostics import DEVICE, ERROR, OK, PROCESSING


def timing_of(rig: Rig, number: int) -> dict[str, str]:
    """Values of the timing message of frame ``number``."""
    rig.until(lambda: len(rig.timings) > number)
    return {pair.key: pair.value for pair in rig.timings[number].status[0].values}


def test_every_third_frame_is_verified() -> None:
    with Rig({"verify_every": 3, "light_names": ["lamp", "sky"], "lights.sky.type": "directional"}) as rig:
        masks = []
        for number in range(7):
            rig.send_mesh(*plate(x=0.05 * number))
            masks.append(rig.trace(wall()))
            values = timing_of(rig, number)
            verified = number % 3 == 2
            assert ("verify.differing" in values, "verify [ms]" in values) == (verified, verified)
            assert values.get("verify.differing", "0") == "0"
        rig.until(lambda: rig.value(PROCESSING, "verified frames") == "2")
        assert rig.value(PROCESSING, "differing") == "0" and not np.array_equal(masks[1], masks[2])
        rig.wait_status(PROCESSING, OK)


def test_switched_on_and_off_live(monkeypatch: pytest.MonkeyPatch) -> None:
    with Rig() as rig:
        rig.send_mesh(*plate())
        before = rig.trace(wall())
        without = rig.core.host.made.device_bytes
        assert "verify.differing" not in timing_of(rig, 0)
        assert rig.set(verify_every=1) == ""
        np.testing.assert_array_equal(rig.trace(wall()), before)
        assert timing_of(rig, 1)["verify.differing"] == "0"
        assert rig.core.host.made.device_bytes > without
        for number, pipeline in enumerate(("mesh_bvh", "brute_force", "light_grid"), 2):  # always by another one
            assert rig.set(pipeline=pipeline) == ""
            np.testing.assert_array_equal(rig.trace(wall()), before)
            assert timing_of(rig, number)["verify.differing"] == "0"
            rig.wait_status(DEVICE, OK, pipeline)
        assert rig.set(verify_every=0) == ""
        np.testing.assert_array_equal(rig.trace(wall()), before)
        assert "verify.differing" not in timing_of(rig, 5)
        rig.until(lambda: rig.core.host.made.device_bytes == without, what="the second pipeline's buffers are freed")
        reserved = f"{without / 1e6:.0f}"
        rig.until(lambda: rig.value(DEVICE, "reserved [MB]") == reserved)


def test_a_disagreement_is_an_error_that_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    verify = ShadowTracer.verify
    wrong = iter([0, 5, 0, 2])

    def spoilt(self: ShadowTracer, *args: Any, **kwargs: Any) -> int:
        assert verify(self, *args, **kwargs) == 0
        return next(wrong)

    monkeypatch.setattr(ShadowTracer, "verify", spoilt)
    with Rig({"verify_every": 1}) as rig:
        rig.send_mesh(*plate())
        rig.trace(wall())
        rig.wait_status(PROCESSING, OK)
        rig.trace(wall())
        assert timing_of(rig, 1)["verify.differing"] == "5"
        status = rig.wait_status(PROCESSING, ERROR, "5 pixels of verified frames differ between two pipelines")
        assert "report" in status.message
        rig.trace(wall())
        rig.trace(wall())
        rig.wait_status(PROCESSING, ERROR, "7 pixels of verified frames differ")
        assert (rig.value(PROCESSING, "verified frames"), rig.value(PROCESSING, "differing")) == ("4", "7")


def test_real_disagreement_is_seen() -> None:
    """The answer of the tracer in use is falsified: the second pipeline tells."""
    with Rig({"verify_every": 1}) as rig:
        rig.send_mesh(*plate())
        rig.trace(wall())
        tracer = rig.core.host.made
        trace = tracer.trace

        def wrong(*args: Any, **kwargs: Any) -> Any:
            frame = trace(*args, **kwargs)
            states = probe.states(frame)
            states[0, 20, 20:23] = 1 - states[0, 20, 20:23]
            return frame

        tracer.trace = wrong  # type: ignore[method-assign]
        rig.trace(wall())
        rig.wait_status(PROCESSING, ERROR, "3 pixels of verified frames differ")
