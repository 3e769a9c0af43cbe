# SPDX-License-Identifier: Apache-2.0
"""``~/dose/*``: what parts receive while the node runs, as topics and services."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness import Rig, plate, wall
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool, Float32
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from shadow_tracer import DoseMap, PointLight, ShadowTracer, Strength
from shadow_tracer.ros.diagnostics import PROCESSING, WARN
from shadow_tracer.scene.dose_colors import NEVER, colors_of

pytestmark = pytest.mark.slow  # exposures are added once a second
PARAMETERS = {
    "dose.parts": ["mesh"], "dose.max_edge": 0.2, "dose.side": "both", "dose.target": 0.5, "dose.goal": 0.3,
    "lights.lamp.power": 40.0,
}  # fmt: skip


def expose(rig: Rig, heard: list[Any]) -> None:
    """Images until something is added."""
    before = len(heard)

    def one() -> bool:
        rig.trace(wall())
        return len(heard) > before

    rig.until(one, timeout=20.0)


def call(rig: Rig, name: str) -> Any:
    return rig.call(Trigger, f"shadow_tracer/dose/{name}", Trigger.Request())


def test_dose_of_a_part(tmp_path: Path) -> None:
    with Rig({**PARAMETERS, "dose.folder": str(tmp_path)}) as rig:
        heard = {
            name: rig.collect(kind, f"shadow_tracer/dose/{name}")
            for name, kind in (("cloud", PointCloud2), ("markers", MarkerArray), ("coverage", Float32), ("done", Bool))
        }
        rig.send_mesh(*plate())
        assert not call(rig, "save").success
        expose(rig, heard["cloud"])
        made = rig.core.exposure.maps["mesh"]
        cloud = heard["cloud"][-1]
        rows = np.frombuffer(
            cloud.data, np.dtype([(f.name, "<u4" if f.name == "rgb" else "<f4") for f in cloud.fields])
        )
        assert [f.name for f in cloud.fields] == ["x", "y", "z", "irradiance", "dose", "rgb"]
        tracer = ShadowTracer("brute_force", device="cpu")
        tracer.scene.put("mesh", *plate())
        alone = DoseMap(tracer, "mesh", 0.2, side="both")
        lamp = PointLight("lamp", (0.5, -0.5, 0.0), strength=Strength(power=40.0))
        assert np.array_equal(rows["irradiance"], alone.irradiance_by([lamp]).astype(np.float32))
        assert np.array_equal(rows["z"], alone.positions()[:, 2].astype(np.float32))
        assert (rows["dose"] > 0.0).any() and made.seconds >= 1.0
        expose(rig, heard["cloud"])
        cloud = heard["cloud"][-1]
        last = np.frombuffer(cloud.data, rows.dtype)
        red, green, blue = colors_of(last["dose"].astype(np.float64), 0.5).astype(np.uint32).T
        assert (last["rgb"] == red << 16 | green << 8 | blue).mean() > 0.99  # but where float32 rounds to the target
        assert (last["dose"] >= rows["dose"]).all() and (last["dose"] > rows["dose"]).any()
        rig.until(lambda: heard["coverage"] and heard["done"] and heard["markers"])
        assert heard["coverage"][-1].data == pytest.approx(made.coverage(0.5), abs=1e-6)
        assert heard["done"][-1].data == (made.coverage(0.5) >= 0.3)
        lists = [marker for marker in heard["markers"][0].markers if marker.action == Marker.ADD]
        assert heard["markers"][0].markers[0].action == Marker.DELETEALL
        assert lists[0].ns == "dose/mesh" and len(lists[0].points) == len(lists[0].colors) == 3 * len(made)
        assert lists[0].colors[0].a == 1.0
        before = made.dose.copy()
        assert call(rig, "save").success and (tmp_path / "mesh.dose.npz").exists()
        assert call(rig, "reset").success and (made.dose == 0.0).all()
        grey = np.array(NEVER, np.float32) / np.float32(255.0)
        rig.until(lambda: {(c.r, c.g, c.b) for c in heard["markers"][-1].markers[-1].colors} == {tuple(grey.tolist())})
        late: list[MarkerArray] = []
        rig.listen(MarkerArray, "shadow_tracer/dose/markers", late)  # and no more images
        rig.until(lambda: late and late[-1].markers[0].action == Marker.DELETEALL and len(late[-1].markers) == 2)
        answer = call(rig, "load")
        assert answer.success, answer.message
        assert np.array_equal(rig.core.exposure.maps["mesh"].dose, before)
        assert rig.set(dose__folder="/nowhere") == ""
        answer = call(rig, "load")
        assert not answer.success and answer.message.startswith("dose.folder: expected a folder")


def test_a_part_that_is_not_published_is_reported() -> None:
    with Rig({**PARAMETERS, "dose.parts": ["wall"]}) as rig:
        rig.send_mesh(*plate())
        coverage = rig.collect(Float32, "shadow_tracer/dose/coverage")
        expose(rig, coverage)
        assert np.isnan(coverage[-1].data)
        rig.wait_status(PROCESSING, WARN, "dose.parts names 'wall', but the parts are mesh; correct the name")


def test_an_image_of_which_nothing_is_known_adds_nothing() -> None:
    with Rig({**PARAMETERS, "camera_info_policy": "exact"}) as rig:
        rig.send_mesh(*plate())
        coverage = rig.collect(Float32, "shadow_tracer/dose/coverage")
        expose(rig, coverage)
        made = rig.core.exposure.maps["mesh"]
        before = made.seconds
        for _ in range(3):
            rig.mask_of(rig.send_frame(wall(), info=False))
        assert made.seconds == before
