# SPDX-License-Identifier: Apache-2.0
"""What counts as exposure while a node runs, by a clock that jumps, pauses and stands still."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import Bounds, DoseMap, IntensityTable, PointLight, ShadowTracer, Strength
from shadow_tracer.ros.parameters.parameter_rows import ParameterError
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.world.exposure import Exposure

LAMP = PointLight("lamp", (0.2, 0.1, 1.0), strength=Strength(power=10.0))
WEAK = PointLight("lamp", (0.2, 0.1, 1.0), strength=Strength(power=10.0, output=0.5))
DARK = PointLight("dark", (0.2, 0.1, 1.0))
SECOND = 1_000_000_000
BEGIN = 1_000 * SECOND


def settings(**values: Any) -> Settings:
    return settings_from({"dose.parts": ["floor"], "dose.max_edge": 1.0, **values})


@pytest.fixture
def world() -> ShadowTracer:
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=1000, max_rays=4096, grid_entries=10_000))
    tracer.scene.put("floor", *geometry.square(2, 0.0, 1.0))
    return tracer


def play(exposure: Exposure, tracer: ShadowTracer, times: list[float], lights: Any = (LAMP,)) -> list[bool]:
    """Images at times of the clock [s]."""
    return [exposure.note(settings(), tracer, lights, BEGIN + round(time * SECOND)) for time in times]


def test_time_between_images_counts_once_a_second(world: ShadowTracer) -> None:
    exposure = Exposure()
    added = play(exposure, world, [0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.25])
    assert added == [False, False, False, False, True, False, True, False]
    assert exposure.maps["floor"].seconds == pytest.approx(2.0) and exposure.trouble == ""
    expected = DoseMap(world, "floor", 1.0)
    expected.add([LAMP], 2.0)
    assert exposure.maps["floor"].dose == pytest.approx(expected.dose, rel=1e-12)


@pytest.mark.parametrize("gap", [1.1, 3600.0, -0.5, -1e6])
def test_pauses_and_jumps_never_count(world: ShadowTracer, gap: float) -> None:
    exposure = Exposure()
    play(exposure, world, [0.0, 0.5, 1.0])
    again = 1.0 + gap
    play(exposure, world, [again, again + 0.5, again + 1.0])
    assert exposure.maps["floor"].seconds == pytest.approx(2.0)


def test_what_an_unknown_image_begins_or_ends_never_counts(world: ShadowTracer) -> None:
    exposure = Exposure()
    play(exposure, world, [0.0, 0.5, 1.0, 1.4])
    exposure.pause()
    play(exposure, world, [1.8, 2.2, 2.8])
    assert exposure.maps["floor"].seconds == pytest.approx(2.0), "0.4 s before the pause are not added later"


def test_a_light_that_changes_counts_as_it_was(world: ShadowTracer) -> None:
    exposure = Exposure()
    play(exposure, world, [0.0, 0.4])
    assert play(exposure, world, [0.8], [WEAK]) == [True]
    assert exposure.maps["floor"].seconds == pytest.approx(0.4)
    assert play(exposure, world, [1.0], []) == [True]
    assert play(exposure, world, [1.5, 2.0, 2.5], [DARK]) == [False, False, False]
    one = DoseMap(world, "floor", 1.0)
    one.add([LAMP], 0.4)
    one.add([WEAK], 0.4)
    assert exposure.maps["floor"].dose == pytest.approx(one.dose, rel=1e-9)


def test_a_table_that_turns_ends_no_exposure_and_another_one_does(world: ShadowTracer) -> None:
    exposure, table = Exposure(), IntensityTable((0.0, 3.0), (0.0,), [[2.0, 1.0]])
    for step in range(4):
        turned = table.hung((0, math.sin(0.1 * step), -math.cos(0.1 * step)), (1, 0, 0))
        lamp = PointLight("lamp", (0, 0, 2), strength=Strength(model=turned))
        assert not exposure.note(settings(), world, [lamp], BEGIN + step * SECOND // 5)
    other = replace(LAMP, strength=Strength(model=IntensityTable((0.0, 3.0), (0.0,), [[2.0, 1.0]])))
    assert exposure.note(settings(), world, [other], BEGIN + 4 * SECOND // 5)
    assert exposure.maps["floor"].seconds == pytest.approx(0.6)


def test_parts_that_are_not_there_or_change(world: ShadowTracer) -> None:
    exposure = Exposure()
    world.scene.put("other", *geometry.square(2, 0.0, 0.5))
    two = settings(**{"dose.parts": ["floor", "wall"]})
    for time in (0, SECOND):
        exposure.note(two, world, [LAMP], BEGIN + time)
    assert exposure.trouble == (
        "dose.parts names 'wall', but the parts are floor, other; correct the name, or publish the part"
    )
    assert exposure.maps["floor"].seconds == 1.0 and not exposure.done(two)
    world.scene.put("floor", *geometry.square(2, 0.0, 2.0))
    assert exposure.shown() == {}
    exposure.note(two, world, [LAMP], BEGIN + 2 * SECOND)
    assert exposure.trouble == (
        "part 'floor' has another mesh than before: its dose began again; "
        "dose.parts names 'wall', but the parts are floor, other; correct the name, or publish the part"
    )
    assert exposure.maps["floor"].seconds == 1.0 and exposure.maps["floor"].area.sum() == pytest.approx(16.0)
    exposure.note(settings(), world, [LAMP], BEGIN + 3 * SECOND)
    assert exposure.trouble == ""


def test_a_part_that_cannot_be_cut_is_reported(world: ShadowTracer) -> None:
    exposure = Exposure()
    fine = settings(**{"dose.max_edge": 1e-4})
    for time in (0, SECOND):
        exposure.note(fine, world, [LAMP], BEGIN + time)
    assert exposure.trouble.startswith("dose of 'floor': max_edge: expected a length") and exposure.maps == {}


def test_coverage_and_done(world: ShadowTracer) -> None:
    exposure = Exposure()
    assert np.isnan(exposure.coverage(1.0)) and not exposure.done(settings())
    play(exposure, world, [0.0, 1.0])
    dose = exposure.maps["floor"].dose
    half = settings(**{"dose.target": float(np.median(dose)), "dose.goal": 0.5})
    assert exposure.done(half) and not exposure.done(settings(**{"dose.target": 1e6}))
    assert exposure.reset() == 1 and exposure.coverage(1e-6) == 0.0


def test_time_before_a_reset_or_before_a_part_is_named_never_counts(world: ShadowTracer) -> None:
    exposure = Exposure()
    play(exposure, world, [0.0, 1.0, 1.9])
    exposure.reset()
    assert play(exposure, world, [2.0, 2.5, 2.9]) == [False, False, False], "0.9 s of the second were before"
    assert play(exposure, world, [3.0]) == [True] and exposure.maps["floor"].seconds == pytest.approx(1.0)
    play(exposure, world, [3.9])
    world.scene.put("wall", *geometry.square(2, 0.5, 0.5))
    two = settings(**{"dose.parts": ["floor", "wall"]})
    exposure.configure(settings(), two)
    for time in (4.0, 4.5, 5.0):
        exposure.note(two, world, [LAMP], BEGIN + round(time * SECOND))
    assert exposure.maps["wall"].seconds == pytest.approx(1.0)
    assert exposure.maps["floor"].seconds == pytest.approx(2.0)


def test_a_part_that_is_named_twice_would_have_twice_the_dose() -> None:
    with pytest.raises(ParameterError, match=r"dose.parts: expected different names, got \['floor', 'floor'\]"):
        settings(**{"dose.parts": ["floor", "", "floor"]})


def test_settings_that_begin_again(world: ShadowTracer) -> None:
    exposure = Exposure()
    play(exposure, world, [0.0, 1.0])
    exposure.configure(settings(), settings(**{"dose.target": 5.0}))
    assert "floor" in exposure.maps
    for change in ({"dose.max_edge": 0.5}, {"dose.side": "back"}, {"dose.parts": ["wall"]}):
        play(exposure, world, [0.0, 1.0])
        exposure.configure(settings(), settings(**change))
        assert exposure.maps == {}, change


def test_saved_and_loaded_all_or_none(world: ShadowTracer, tmp_path: Path) -> None:
    world.scene.put("markers/a/1", *geometry.square(2, 0.5, 0.5))
    two = settings(**{"dose.parts": ["floor", "markers/a/1"], "dose.folder": str(tmp_path)})
    exposure, other = Exposure(), Exposure()
    with pytest.raises(ValueError, match="there is no dose map to save"):
        exposure.save(two)
    with pytest.raises(ValueError, match="dose.folder: expected a folder for dose maps, got none"):
        exposure.save(settings())
    with pytest.raises(ValueError, match="dose.folder: expected a folder, got '/nowhere'"):
        exposure.load(settings(**{"dose.folder": "/nowhere"}), world)
    for time in (0, SECOND):
        exposure.note(two, world, [LAMP], BEGIN + time)
    assert exposure.save(two) == 2
    assert other.load(two, world) == 2
    for part, each in exposure.maps.items():
        assert np.array_equal(other.maps[part].dose, each.dose)
    kept = other.maps
    with pytest.raises(ValueError, match="path: expected a dose map that was saved"):
        other.load(settings(**{"dose.parts": ["floor", "wall"], "dose.folder": str(tmp_path)}), world)
    with pytest.raises(ValueError, match=r"dose.max_edge, dose.side: expected 1 and front as in the file of 'floor'"):
        other.load(settings(**{"dose.max_edge": 0.5, "dose.folder": str(tmp_path)}), world)
    with pytest.raises(
        ValueError, match="dose.parts: expected names of the parts whose dose maps are loaded, got none"
    ):
        other.load(settings(**{"dose.parts": [""], "dose.folder": str(tmp_path)}), world)
    (tmp_path / "floor.dose.npz").rename(tmp_path / "wall.dose.npz")
    with pytest.raises(ValueError, match="part: expected 'wall' in '.*', got 'floor'"):
        other.load(settings(**{"dose.parts": ["wall"], "dose.folder": str(tmp_path)}), world)
    assert other.maps is kept


def test_another_tracer_goes_on(world: ShadowTracer) -> None:
    exposure = Exposure()
    play(exposure, world, [0.0, 1.0])
    exposure.release()
    assert exposure.shown() == {} and exposure.maps["floor"].tracer is None
    next_one = ShadowTracer(device="cpu", bounds=world.bounds)
    next_one.scene.put("floor", *geometry.square(2, 0.0, 1.0))
    play(exposure, next_one, [10.0, 11.0])
    assert exposure.maps["floor"].seconds == pytest.approx(2.0) and exposure.maps["floor"].tracer is next_one
