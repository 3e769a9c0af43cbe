# SPDX-License-Identifier: Apache-2.0
"""Which camera_info belongs to an image: that of its stamp, the newest, or the newest if nothing is against it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shadow_tracer.ros.cameras.camera_infos import CameraInfos
from shadow_tracer.ros.diagnostics import Missing

PERIOD = 33_000_000
CAPACITY = 32


def info(stamp: int, focal: float = 60.0) -> Any:
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    time = SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=time, frame_id="camera"), width=64, height=48, distortion_model="plumb_bob",
        d=np.zeros(5), k=np.full(9, focal), r=np.zeros(9), p=np.zeros(12), binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


class Camera:
    """Infos and images as they arrive."""

    def __init__(self) -> None:
        self.infos = CameraInfos()

    def info(self, stamp: int, focal: float = 60.0) -> None:
        self.infos.put(info(stamp, focal), CAPACITY)

    def image(self, stamp: int, last_chance: bool = False, policy: str = "auto") -> float | None:
        """The focal length of the image; None if it waits or is unknown."""
        self.infos.note_image(stamp)
        return self.ask(stamp, last_chance, policy)

    def ask(self, stamp: int, last_chance: bool = False, policy: str = "auto") -> float | None:
        try:
            return float(self.infos.find(stamp, policy, last_chance).k[0])
        except Missing as missing:
            assert "no camera_info" in missing.text and missing.wait
            return None


@pytest.fixture
def camera() -> Camera:
    return Camera()


def test_a_stamp_of_its_own_goes_before_all_else(camera: Camera) -> None:
    for k in range(9):
        camera.info(k * PERIOD, 60.0 + k)
    assert [camera.image(k * PERIOD) for k in range(9)] == [60.0 + k for k in range(9)]


def test_latched_once(camera: Camera) -> None:
    """The first image waits for a camera_info of its stamp; that none comes is known from the third one on."""
    camera.info(5)
    assert camera.image(PERIOD) is None and camera.ask(PERIOD, True) == 60.0
    assert [camera.image(k * PERIOD) for k in range(2, 99)] == [60.0] * 97


def test_one_nanosecond_off(camera: Camera) -> None:
    found = []
    for k in range(1, 20):
        camera.info(k * PERIOD + 1)
        found.append(camera.image(k * PERIOD))
    assert found[2:] == [60.0] * 17


def test_one_for_many_images(camera: Camera) -> None:
    """Where one comes with its image all is as exact as can be; between them no image waits."""
    found = []
    for k in range(1, 91):
        if k % 30 == 1:
            camera.info(k * PERIOD)
        found.append(camera.image(k * PERIOD))
    assert found[0] == 60.0 and found[3:] == [60.0] * 87


def test_it_may_come_after_its_image(camera: Camera) -> None:
    """A camera that changes its lens, with camera_info behind each image: none is answered by that of another."""
    for k in range(1, 20):
        stamp = k * PERIOD
        assert camera.image(stamp) is None
        camera.info(stamp, 60.0 + k)
        assert camera.ask(stamp) == 60.0 + k


def test_after_a_lost_one_the_stamp_is_waited_for_again(camera: Camera) -> None:
    for k in range(1, 20):
        stamp = k * PERIOD
        found = camera.image(stamp)
        assert found is None or k in (11, 12)  # the two images after the lost one
        if k != 10:
            camera.info(stamp)
        assert camera.ask(stamp, True) == 60.0


def test_a_lens_that_moves_is_unknown_between_two_stamps(camera: Camera) -> None:
    for k in range(1, 20):
        camera.info(k * PERIOD + 1, 60.0 + k)
    assert camera.image(5 * PERIOD, True) is None
    assert camera.image(30 * PERIOD, True) is None  # nor is the last one believed, which differs from those before
    with pytest.raises(Missing, match="those around it differ; publish it with each image, or set camera_info_policy"):
        camera.infos.find(5 * PERIOD, "auto", True)
    assert camera.ask(5 * PERIOD, True, "latest") == 79.0


def test_between_two_that_are_equal(camera: Camera) -> None:
    camera.info(1)
    camera.info(100)
    camera.info(200, 99.0)
    assert camera.image(50, True) == 60.0 and camera.image(150, True) is None


def test_a_change_is_believed_when_it_is_repeated_or_stays(camera: Camera) -> None:
    camera.info(1)
    camera.info(2, 70.0)
    found = [camera.image(k * PERIOD, True) for k in range(1, 12)]
    assert found == [None] * 7 + [70.0] * 4
    camera.info(3, 80.0)
    assert camera.image(12 * PERIOD, True) is None
    camera.info(4, 80.0)
    assert camera.image(13 * PERIOD, True) == 80.0


def test_without_stamps(camera: Camera) -> None:
    """Some drivers leave the stamp of camera_info at 0; a change is seen all the same."""
    for _ in range(3):
        camera.info(0)
    assert camera.image(PERIOD, True) == 60.0
    camera.info(0, 70.0)
    assert camera.image(2 * PERIOD, True) is None


def test_exact_and_latest(camera: Camera) -> None:
    with pytest.raises(Missing, match="no camera_info has arrived"):
        camera.infos.find(1, "latest", True)
    for stamp in range(1, CAPACITY + 2):
        camera.info(stamp, float(stamp))
    assert camera.ask(3, policy="exact") == 3.0 and camera.ask(3, policy="latest") == CAPACITY + 1
    with pytest.raises(Missing, match="set camera_info_policy to auto, or to latest"):
        camera.infos.find(1, "exact", True)  # pushed out by the later ones
    camera.infos.clear()
    for policy in ("auto", "exact", "latest"):
        with pytest.raises(Missing, match="no camera_info has arrived"):
            camera.infos.find(3, policy, True)
