# SPDX-License-Identifier: Apache-2.0
"""Dose maps: texels, sums over time while things move, what is known of them, and files."""

from __future__ import annotations

import csv
import gc
import math
import re
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import geometry
import numpy as np
import pytest
from interrupts import Ring, Steps

import shadow_tracer
from shadow_tracer import (
    DoseMap,
    Frame,
    IntensityTable,
    PointLight,
    RectangleLight,
    Scene,
    ShadowTracer,
    Strength,
    TubeLight,
    plan_positions,
)
from shadow_tracer.scene.dose_colors import NEVER, REACHED, colors_of, viridis
from shadow_tracer.scene.texels import cut

TUBE = TubeLight("tube", (-0.6, 0.1, 1.2), (0.6, 0.1, 1.2), 0.02, samples=16, strength=Strength(power=15.0))
POINT = PointLight("point", (0.3, -0.5, 1.5), strength=Strength(intensity=4.0))
PANEL = RectangleLight("a panel", (0, 0, 1.8), (0.5, 0, 0), (0, -0.4, 0), samples=16, strength=Strength(exitance=3.0))
LIGHTS = [TUBE, POINT, PANEL]


def at(x: float, y: float, z: float, turn: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, :2] = (math.cos(turn), -math.sin(turn)), (math.sin(turn), math.cos(turn))
    pose[:3, 3] = x, y, z
    return pose


def put_scene(tracer: ShadowTracer) -> None:
    """A table, a shelf that hides part of it, and a thing that moves."""
    tracer.scene.clear()
    tracer.scene.put("table", *geometry.square(2, 0.0, 1.0))
    tracer.scene.put("shelf", *geometry.square(2, 0.5, 0.3, (0.4, 0.2)))
    tracer.scene.put("robot", *geometry.box((-0.2, -0.2, 0.2), (0.2, 0.2, 0.6)))


def expose(tracer: ShadowTracer, lights: Any = LIGHTS) -> DoseMap:
    """With the occluder, the light and the part itself elsewhere each time."""
    put_scene(tracer)
    dose_map = DoseMap(tracer, "table", 0.2)
    for step in range(3):
        tracer.scene.move("robot", at(0.3 * step - 0.4, 0.0, 0.0, 0.5 * step))
        tracer.scene.move("table", at(0.1 * step, 0.0, 0.0, 0.2 * step))
        moved = [replace(each, position=(0.1 * step, -0.5, 1.5)) if each is POINT else each for each in lights]
        dose_map.add(moved, 2.0 + step)
    return dose_map


@pytest.mark.parametrize("side", ["front", "back", "both"])
def test_texels_are_the_surface(side: str) -> None:
    scene = Scene()
    vertices, triangles = geometry.icosphere(1, 0.7)
    scene.put("ball", vertices, triangles)
    texels = cut(scene["ball"], 0.1, side)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    whole = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert texels.area.sum() == pytest.approx(whole * (2.0 if side == "both" else 1.0), rel=1e-13)
    edges = np.linalg.norm(texels.corners - texels.corners[:, [1, 2, 0]], axis=2)
    assert 0.04 < edges.max() <= 0.1
    a, b, c = texels.corners.transpose(1, 0, 2)
    across = 0.5 * np.cross(b - a, c - a)
    assert np.linalg.norm(across, axis=1) == pytest.approx(texels.area, rel=1e-9)
    assert across / texels.area[:, None] == pytest.approx(texels.normals, abs=1e-9)
    outwards = (texels.normals * texels.centres).sum(axis=1) > 0.0
    assert outwards.mean() == {"front": 1.0, "back": 0.0, "both": 0.5}[side]
    assert texels.area.max() <= 4.0 * texels.area.min()


def test_slivers_have_few_texels_and_what_has_no_area_none() -> None:
    scene = Scene()
    vertices = [(0, 0, 0), (10, 0, 0), (5, 0.01, 0), (20, 0, 0), (math.nan, 0, 0)]
    scene.put("sliver", vertices, [(0, 1, 2), (0, 1, 3), (0, 1, 4)], nonfinite="skip")
    texels = cut(scene["sliver"], 0.05)
    assert texels.area.sum() == pytest.approx(0.05, rel=1e-12) and len(texels.area) < 10_000
    scene.put("line", vertices[:4], [(0, 1, 3)])
    with pytest.raises(ValueError, match="part: expected a mesh with a surface, got 'line'"):
        cut(scene["line"], 0.05)
    with pytest.raises(ValueError, match="max_edge: expected a length at which 'sliver' has at most 20000000 texels"):
        cut(scene["sliver"], 1e-9)


def test_the_same_bits_in_every_pipeline(tracer: ShadowTracer, tracers: Any) -> None:
    maps = [expose(each) for each in (tracers(tracer.device, "brute_force", "filtered"), tracer)]
    assert np.array_equal(maps[0].dose, maps[1].dose) and (maps[0].dose > 0.0).any() and maps[0].never_reached.any()
    assert np.array_equal(maps[0].seconds_lit, maps[1].seconds_lit)


def test_the_same_bits_with_lights_in_any_order_and_any_threads(any_device: str) -> None:
    one, two = ShadowTracer(device=any_device, threads=1), ShadowTracer(device=any_device, threads=2)
    first = expose(one)
    for lights in (LIGHTS[::-1], LIGHTS[1:] + LIGHTS[:1]):
        assert np.array_equal(expose(two, lights).dose, first.dose)


def test_dose_is_irradiance_times_time(reference: ShadowTracer) -> None:
    put_scene(reference)
    dose_map = DoseMap(reference, "table", 0.2)
    places = dose_map.positions()
    expected = np.zeros(len(dose_map))
    for seconds, x in ((3.0, 0.0), (0.5, 0.3)):
        reference.scene.move("robot", at(x, 0.0, 0.0))
        found = sum(reference.irradiance(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)), LIGHTS))
        expected += seconds * found
        dose_map.add(LIGHTS, seconds)
        assert dose_map.irradiance == pytest.approx(found, rel=1e-12)
    assert dose_map.dose == pytest.approx(expected, rel=1e-12)
    assert dose_map.seconds == 3.5
    lit = dose_map.seconds_lit
    assert set(np.unique(lit)) <= {0.0, 0.5, 3.0, 3.5} and len(np.unique(lit)) > 1
    assert np.array_equal(dose_map.never_reached, lit == 0.0)


def test_ten_seconds_twice_are_twenty_once(reference: ShadowTracer) -> None:
    put_scene(reference)
    once, twice = DoseMap(reference, "table", 0.2), DoseMap(reference, "table", 0.2)
    once.add(LIGHTS, 20.0)
    twice.add(LIGHTS, 10.0)
    there = reference.scene["robot"].pose
    reference.scene.move("robot", at(5.0, 5.0, 0.0))  # and back again
    twice.add(LIGHTS, 0.0)
    reference.scene.move("robot", there)
    twice.add(LIGHTS, 10.0)
    assert np.array_equal(once.dose, twice.dose) and np.array_equal(once.seconds_lit, twice.seconds_lit)


def test_output_can_change_between_exposures(reference: ShadowTracer) -> None:
    put_scene(reference)
    full, half = DoseMap(reference, "table", 0.2), DoseMap(reference, "table", 0.2)
    full.add([TUBE], 10.0)
    half.add([replace(TUBE, strength=replace(TUBE.strength, output=0.5))], 20.0)
    assert half.dose == pytest.approx(full.dose, rel=1e-14)


def test_texels_move_with_the_part(reference: ShadowTracer) -> None:
    """A part that moves together with lamp and occluders receives what it does where it is at rest."""
    put_scene(reference)
    resting = DoseMap(reference, "table", 0.2)
    resting.add([POINT], 1.0)
    pose = at(3.0, -2.0, 0.7, 1.1)
    pose[:3, :3] = pose[:3, :3] @ geometry.rotation(np.random.default_rng(7))
    for name in ("table", "shelf", "robot"):
        reference.scene.move(name, pose)
    moved = PointLight("point", pose[:3, :3] @ POINT.position + pose[:3, 3], strength=POINT.strength)
    turned = DoseMap(reference, "table", 0.2)
    turned.add([moved], 1.0)
    differ = ~np.isclose(turned.dose, resting.dose, rtol=1e-9)
    assert differ.mean() < 0.02, "but for texels at edges of shadows"
    assert turned.positions() == pytest.approx(resting.corners.mean(axis=1) @ pose[:3, :3].T + pose[:3, 3], abs=1.1e-3)


def test_far_from_the_origin(reference: ShadowTracer) -> None:
    """No texel hides itself for roundings a thousand kilometres away."""
    put_scene(reference)
    near = DoseMap(reference, "table", 0.2)
    near.add([POINT], 1.0)
    shift = np.array([1e6, -2e6, 3e5])
    for name in ("table", "shelf", "robot"):
        reference.scene.move(name, at(*shift.tolist()))
    far = DoseMap(reference, "table", 0.2)
    far.add([replace(POINT, position=POINT.position + shift)], 1.0)
    assert np.isclose(far.dose, near.dose, rtol=1e-6).mean() > 0.98, "but for texels at edges of shadows"


def test_both_sides_are_apart(reference: ShadowTracer) -> None:
    put_scene(reference)
    dose_map = DoseMap(reference, "table", 0.2, side="both")
    below = PointLight("below", (0.0, 0.0, -1.0), strength=Strength(power=5.0))
    dose_map.add([below], 1.0)
    half = len(dose_map) // 2
    assert (dose_map.dose[:half] == 0.0).all() and (dose_map.dose[half:] > 0.0).all()
    assert dose_map.area.sum() == pytest.approx(8.0)


def test_coverage_goes_by_area(reference: ShadowTracer) -> None:
    reference.scene.put(
        "two", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (50, 0, 0), (50, 2, 0), (48, 0, 0)], [(0, 1, 2), (3, 4, 5)]
    )
    dose_map = DoseMap(reference, "two", 10.0)
    assert np.array_equal(dose_map.area, [0.5, 2.0])
    dose_map.add([PointLight("near", (0.3, 0.3, 1.0), range=10.0, strength=Strength(intensity=1.0))], 100.0)
    assert dose_map.coverage(50.0) == 0.2
    assert dose_map.coverage(1e6) == 0.0
    assert np.array_equal(dose_map.never_reached, [False, True])


def test_what_remains(reference: ShadowTracer) -> None:
    put_scene(reference)
    dose_map = DoseMap(reference, "table", 0.2)
    dose_map.add([TUBE], 30.0)
    target = float(np.median(dose_map.dose[dose_map.dose > 0.0]))
    left = dose_map.remaining([POINT], target)
    assert np.array_equal(left == 0.0, dose_map.dose >= target)
    assert np.array_equal(np.isinf(left), (dose_map.dose < target) & (dose_map.irradiance_by([POINT]) == 0.0))
    some = np.isfinite(left) & (left > 0.0)
    assert some.any() and dose_map.seconds == 30.0
    dose_map.add([POINT], float(left[some].max()) * (1.0 + 1e-12))
    assert (dose_map.dose[some] >= target).all()


def test_what_is_unknown_is_never_dose(reference: ShadowTracer) -> None:
    """Texels inside a lamp."""
    reference.scene.put("table", *geometry.square(2, 0.0, 1.0))
    dose_map = DoseMap(reference, "table", 0.2)
    inside = TubeLight("tube", (-2, 0.0, 0.1), (2, 0.0, 0.1), 0.3, samples=8, strength=Strength(power=5.0))
    dose_map.add([inside], 1.0)
    unknown = np.isnan(dose_map.irradiance)
    assert unknown.any() and not unknown.all()
    assert (dose_map.dose[unknown] == 0.0).all() and (dose_map.seconds_lit[unknown] == 0.0).all()
    assert (dose_map.dose[~unknown] > 0.0).any()


@pytest.mark.slow
def test_a_million_samples_and_a_thousand_adds_scaled_down(reference: ShadowTracer) -> None:
    """Float64 sums of equal steps drift by less than their count times 2^-53, and nothing grows with the number of
    exposures. 200 texels and 1,000 exposures: texels do not know each other, so more of them show nothing more."""
    reference.scene.put("table", *geometry.square(2, 0.0, 1.0))
    dose_map = DoseMap(reference, "table", 0.2)
    dose_map.add([POINT], 0.1)
    one = dose_map.dose.copy()
    held = {name: len(value) for name, value in vars(dose_map).items() if hasattr(value, "__len__")}
    for _ in range(299):
        dose_map.add([POINT], 0.1)
    tracemalloc.start()
    for _ in range(200):
        dose_map.add([POINT], 0.1)
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(500):
        dose_map.add([POINT], 0.1)
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 500 * len(dose_map), "an array that is kept would be eight bytes a texel and exposure"
    assert (np.abs(dose_map.dose / (1000.0 * one) - 1.0) <= 1000 * 2.0**-53).all()
    assert {name: len(value) for name, value in vars(dose_map).items() if hasattr(value, "__len__")} == held
    assert abs(dose_map.seconds - 100.0) <= 1000 * 2.0**-53 * 100.0


def test_a_refused_exposure_adds_nothing(reference: ShadowTracer) -> None:
    put_scene(reference)
    dose_map = DoseMap(reference, "table", 0.2)
    dose_map.add([POINT], 1.0)
    before = dose_map.dose
    dark = PointLight("dark", (0, 0, 1))
    for lights, seconds, says in (
        ([dark], 1.0, "strength: the light 'dark' has none"),
        ([POINT], -1.0, "seconds: expected a finite time of 0 or more, got -1.0"),
        ([POINT], math.nan, "seconds: expected"),
        ([], 1.0, "lights: expected at least one light"),
    ):
        with pytest.raises(ValueError, match=says):
            dose_map.add(lights, seconds)
    assert dose_map.dose is before and dose_map.seconds == 1.0
    with pytest.raises(ValueError, match="threshold: expected a positive dose in J/m2, got 0"):
        dose_map.coverage(0)
    with pytest.raises(ValueError, match="read-only"):
        dose_map.dose[0] = 3.0


def test_an_exposure_that_is_interrupted_adds_all_or_nothing(reference: ShadowTracer) -> None:
    """At steps spread over all of it, and at each of the last, where what has grown is stored."""
    put_scene(reference)
    dose_map, other = DoseMap(reference, "table", 0.5), DoseMap(reference, "table", 0.5)
    steps, states = Steps(), []
    for _ in range(16):  # kernels are loaded before steps are counted
        other.add([TUBE, POINT], 1.0)
        states.append((other.dose, other.seconds_lit, other.irradiance, other.seconds))
    count = steps.count(lambda: dose_map.add([TUBE, POINT], 1.0))
    added = 1
    for at in [*range(count // 7, count, count // 7), *range(count - 5, count + 1)]:
        with pytest.raises(Ring):
            steps.run(lambda: dose_map.add([TUBE, POINT], 1.0), at)
        assert dose_map.seconds in (added, added + 1)
        added = round(dose_map.seconds)
        state = dose_map.dose, dose_map.seconds_lit, dose_map.irradiance, dose_map.seconds
        assert all(np.array_equal(mine, theirs) for mine, theirs in zip(state, states[added - 1], strict=True)), at
    assert added < 16


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ({"part": "chair"}, r"part: expected one of \['table', 'shelf', 'robot'\], got 'chair'"),
        ({"max_edge": 0.0}, "max_edge: expected a positive length in metres, got 0.0"),
        ({"max_edge": math.inf}, "max_edge"),
        ({"max_edge": 1e-200}, "max_edge: expected a length at which 'table' has at most"),
        ({"offset": -1.0}, "offset: expected a length in metres of 0 or more"),
        ({"side": "top"}, "side: expected one of 'front', 'back', 'both', got 'top'"),
    ],
)
def test_maps_that_are_refused(reference: ShadowTracer, what: dict[str, Any], says: str) -> None:
    put_scene(reference)
    with pytest.raises(ValueError, match=says):
        DoseMap(reference, **{"part": "table", **what})


def test_a_part_that_becomes_another_surface(reference: ShadowTracer) -> None:
    put_scene(reference)
    dose_map = DoseMap(reference, "table", 0.2)
    vertices, triangles = geometry.square(2, 0.0, 1.0)
    reference.scene.put("table", vertices, triangles, at(1, 2, 0))  # the same one again
    dose_map.add([POINT], 1.0)
    reference.scene.deform("table", vertices * 1.01)
    with pytest.raises(ValueError, match="part: 'table' has other vertices or triangles"):
        dose_map.add([POINT], 1.0)
    reference.scene.remove("table")
    with pytest.raises(ValueError, match=r"part: expected one of \['shelf', 'robot'\], got 'table'"):
        dose_map.add([POINT], 1.0)
    assert dose_map.seconds == 1.0


def test_saved_and_loaded_bit_for_bit(reference: ShadowTracer, tmp_path: Path) -> None:
    made = expose(reference)
    made.save(tmp_path / "dose")
    loaded = DoseMap.load(tmp_path / "dose", reference)
    for name in (
        "dose",
        "seconds_lit",
        "irradiance",
        "area",
        "corners",
        "normals",
        "seconds",
        "part",
        "max_edge",
        "side",
    ):
        assert np.array_equal(getattr(loaded, name), getattr(made, name)), name
    for each in (made, loaded):
        each.add(LIGHTS, 1.5)
    assert np.array_equal(loaded.dose, made.dose)
    alone = DoseMap.load(tmp_path / "dose")
    assert alone.coverage(1.0) > 0.0
    with pytest.raises(ValueError, match="tracer: this map was loaded without one"):
        alone.add(LIGHTS, 1.0)
    with pytest.raises(ValueError, match="tracer: expected a ShadowTracer, got str"):
        DoseMap.load(tmp_path / "dose", "cpu")  # type: ignore[arg-type]
    reference.scene.put("table", *geometry.square(2, 0.0, 1.5))
    with pytest.raises(ValueError, match="part: 'table' has other vertices or triangles"):
        DoseMap.load(tmp_path / "dose", reference)
    reference.scene.remove("table")
    with pytest.raises(
        ValueError, match=r"part: expected one of \['shelf', 'robot'\], got 'table', whose dose this is"
    ):
        DoseMap.load(tmp_path / "dose", reference)


def test_a_file_stays_until_the_next_one_is_whole(
    reference: ShadowTracer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = expose(reference)
    made.save(tmp_path / "dose.npz")
    before = (tmp_path / "dose.npz").read_bytes()

    def full(file: Any, **_fields: Any) -> None:
        file.write(b"PK")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="No space left"):
        made.save(tmp_path / "dose.npz")
    assert (tmp_path / "dose.npz").read_bytes() == before and len(list(tmp_path.iterdir())) == 1


def test_damaged_files_are_refused(reference: ShadowTracer, tmp_path: Path) -> None:
    """Bytes that are other ones, or missing at the end; what does not matter to the content may be read."""
    put_scene(reference)
    made, path = DoseMap(reference, "table", 0.7), tmp_path / "dose.npz"
    made.add(LIGHTS, 1.0)
    made.save(path)
    good, refused = path.read_bytes(), 0
    for place in range(0, len(good), 53):
        for data in (good[:place], good[:place] + bytes([good[place] ^ 0x55]) + good[place + 1 :]):
            path.write_bytes(data)
            try:
                loaded = DoseMap.load(path)
            except ValueError:
                refused += 1
                continue
            for name in ("dose", "seconds_lit", "irradiance", "area", "corners", "normals", "seconds", "part", "side"):
                assert np.array_equal(getattr(loaded, name), getattr(made, name)), (place, name)
    assert refused > len(good) / 53


def test_files_that_are_no_maps(reference: ShadowTracer, tmp_path: Path) -> None:
    path = tmp_path / "dose.npz"
    with pytest.raises(ValueError, match="path: expected a dose map that was saved"):
        DoseMap.load(path)
    path.write_bytes(b"nothing")
    with pytest.raises(ValueError, match="path: expected a dose map that was saved"):
        DoseMap.load(path)
    with open(path, "wb") as file:
        np.save(file, np.ones(3))
    with pytest.raises(ValueError, match="path: expected a dose map that was saved"):
        DoseMap.load(path)
    put_scene(reference)
    DoseMap(reference, "table", 0.5).save(path)
    good = dict(np.load(path))
    for change, says in (
        ({"version": np.array(9)}, "version: expected 1"),
        ({"dose": good["dose"][1:]}, r"dose: expected float64 of shape \(64,\), got float64 of shape \(63,\)"),
        ({"dose": good["dose"].astype(np.float32)}, "dose: expected float64"),
        ({"seconds": np.array(-1.0)}, "seconds: expected a finite number of 0 or more"),
        ({"seconds": np.array(math.inf)}, "seconds: expected a finite number of 0 or more"),
        ({"part": np.array(3)}, "part: expected a text"),
        ({"version": np.array("1")}, "version: expected 1"),
        ({"side": np.array("top")}, "side: expected one of 'front', 'back', 'both', got 'top'"),
        ({"dose": good["dose"] * math.nan}, "dose: expected numbers of 0 or more"),
        ({"seconds_lit": good["dose"] - 1.0}, "seconds_lit: expected numbers of 0 or more"),
        ({"irradiance": good["dose"] - 1.0}, "irradiance: expected numbers of 0 or more, NaN where unknown"),
        ({"normals": np.full_like(good["normals"], math.inf)}, "normals: expected finite numbers"),
        (
            {name: value[:0] for name, value in good.items() if value.ndim},
            r"corners: expected float64 of shape \(1, 3, 3\)",
        ),
        ({"area": None}, "area: missing in"),
    ):
        np.savez(path, **{name: value for name, value in {**good, **change}.items() if value is not None})
        with pytest.raises(ValueError, match=says):
            DoseMap.load(path)


def test_a_table_with_units(reference: ShadowTracer, tmp_path: Path) -> None:
    made = expose(reference)
    made.write_csv(tmp_path / "dose.csv")
    with open(tmp_path / "dose.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(made)
    for column, values in (
        ("dose_J_per_m2", made.dose),
        ("area_m2", made.area),
        ("irradiance_W_per_m2", made.irradiance),
    ):
        assert np.array_equal([float(row[column]) for row in rows], values)
    assert float(rows[3]["x_m"]) == made.corners[3].mean(axis=0)[0]


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_coloured_meshes(reference: ShadowTracer, tmp_path: Path, ending: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    made = expose(reference)
    target = float(np.quantile(made.dose, 0.8))
    made.write_mesh(tmp_path / f"dose.{ending}", target)
    mesh = trimesh.load(tmp_path / f"dose.{ending}", force="mesh", process=False)
    assert mesh.area == pytest.approx(made.area.sum(), rel=1e-5)
    colors = np.asarray(mesh.visual.vertex_colors)[::3, :3]
    assert np.array_equal(colors, colors_of(made.dose, target))
    with pytest.raises(ValueError, match="path: expected a name that ends with .ply or .glb"):
        made.write_mesh(tmp_path / "dose.stl")


def test_colors() -> None:
    colors = colors_of(np.array([0.0, 1e-9, 5.0, 10.0, 20.0]), 10.0)
    assert tuple(colors[0]) == NEVER and tuple(colors[3]) == tuple(colors[4]) == REACHED
    assert np.array_equal(colors[1:3], viridis([0.0, 0.5]))
    assert np.array_equal(colors_of(np.array([4.0, 8.0]), None), viridis([0.5, 1.0]))
    matplotlib = pytest.importorskip("matplotlib")
    steps = np.linspace(0.0, 1.0, 256)
    theirs = 255.0 * matplotlib.colormaps["viridis"](steps)[:, :3]
    assert np.abs(viridis(steps) - theirs).max() <= 6.0


@pytest.mark.slow
def test_a_picture_shows_the_three_colours(reference: ShadowTracer, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    image_module = pytest.importorskip("PIL.Image")
    made = expose(reference)
    made.picture(tmp_path / "dose.png", target=float(np.quantile(made.dose, 0.8)))
    pixels = np.asarray(image_module.open(tmp_path / "dose.png").convert("RGB"))
    for color in (NEVER, REACHED):
        assert (pixels == color).all(axis=-1).sum() > 500
    with pytest.raises(ValueError, match="target: expected a positive dose"):
        made.picture(tmp_path / "dose.png", target=-1.0)


def test_legends_have_units(reference: ShadowTracer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = pytest.importorskip("matplotlib.figure").Figure
    drawn: list[Any] = []
    monkeypatch.setattr(figure, "savefig", lambda self, *_, **__: drawn.append(self))
    expose(reference).picture(tmp_path / "dose.png", target=2.0)
    axes, bar = drawn[0].axes
    assert bar.get_ylabel() == "dose [J/m²]"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["at least 2 J/m²", "never reached"]
    assert re.fullmatch(r"table: .* % of .* m² has 2 J/m² \(0.2 mJ/cm²\) after .* s", axes.get_title())


@pytest.mark.parametrize(
    ("where", "names", "unit"),
    [
        (DoseMap, ("dose", "coverage", "remaining", "add"), ("J/m2", "[s]", "seconds")),
        (DoseMap, ("irradiance", "irradiance_by"), ("W/m2",)),
        (DoseMap, ("area",), ("m2",)),
        (DoseMap, ("seconds", "seconds_lit"), ("[s]",)),
        (Frame, ("irradiance",), ("W/m2",)),
        (ShadowTracer, ("irradiance",), ("W/m2",)),
        (shadow_tracer, ("irradiance_matrix",), ("W/m2",)),
        (shadow_tracer, ("plan_positions", "Plan"), ("J/m2",)),
        (shadow_tracer, ("Strength",), ("[W]", "[W/sr]", "[W/m2]")),
        (shadow_tracer, ("IntensityTable",), ("W/sr", "rad")),
    ],
)
def test_docstrings_have_units(where: Any, names: tuple[str, ...], unit: tuple[str, ...]) -> None:
    for name in names:
        text = getattr(where, name).__doc__
        assert any(each in text for each in unit) if where is DoseMap else all(each in text for each in unit), name


def test_no_message_says_lux_of_what_is_no_light_for_eyes() -> None:
    """W/m2 and lx are not the same; there is a message for illuminance, and it is not the one."""
    package = Path(shadow_tracer.__file__).parent
    told = "\n".join(path.read_text(encoding="utf-8") for path in package.rglob("*.py"))
    assert "Illuminance" not in told and "[lx]" not in told


@pytest.mark.parametrize(
    ("module", "use"),
    [
        ("trimesh", lambda made, path: made.write_mesh(path / "dose.ply")),
        ("matplotlib", lambda made, path: made.picture(path / "dose.png")),
        ("scipy", lambda made, path: plan_positions(made, [[POINT]], 1e-3, method="highs")),
        ("photompy", lambda made, path: IntensityTable.from_ies(path / "lamp.ies", "W/sr")),
    ],
    ids=["trimesh", "matplotlib", "scipy", "photompy"],
)
def test_what_is_not_installed_is_named(
    reference: ShadowTracer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, module: str, use: Any
) -> None:
    put_scene(reference)
    made = DoseMap(reference, "table", 0.5)
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    extra = "photometry" if module == "photompy" else "dose"
    with pytest.raises(ImportError, match=rf"{module}: pip install 'shadow_tracer\[{extra}\]'"):
        use(made, tmp_path)
