# SPDX-License-Identifier: Apache-2.0
"""The benchmark suite: each section on a tiny scene; wrong answers have no time, or stop it."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rivals
import suite
import suite_settings
import suite_targets
from case import Case, Wrong
from contest import Effort, _rounds, contest
from scenes import View, procedural_view, views
from stolen import stolen
from suite_settings import Clock, Settings

from shadow_tracer import Bounds, available_pipelines

_ROOT = Path(__file__).resolve().parents[2]
_VIEW = "stadium/pot/inside"
_TINY = replace(
    suite_settings.quick(100.0),
    size=24,
    views=(_VIEW,),
    views_few=(_VIEW,),
    effort=Effort(1, 0.0),
    sizes=(16, 32),
    triangles=(100, 400),
    lights=(1, 2),
    maps=(32, 128),
    asked=((36, 100),),
    variants_size=12,
)


@pytest.fixture(autouse=True)
def small_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """The view of _TINY with some hundred triangles instead of 70,000."""
    import suite_maps
    import suite_points
    import suite_scaling
    import suite_scenes

    def small(size: int, wanted: list[str]) -> list[View]:
        assert wanted == [_VIEW]
        return [_view(size)]

    for module in (suite_scenes, suite_points, suite_scaling, suite_maps, sys.modules["scenes"]):
        monkeypatch.setattr(module, "views", small)


def _view(size: int) -> View:
    return procedural_view("stadium", "pot", "inside", size, 600, 2)


def _run(section: str, settings: Settings = _TINY) -> dict[str, Any]:
    return suite.run(settings, [section], quiet=True)[section]


@pytest.mark.slow
def test_all_methods_take_part_and_ours_are_right() -> None:
    found = _run("scenes")
    rows = {row["method"]: row for row in found["rows"]}
    ours = {"/".join(pair) for pair in suite_settings.fast()}
    assert ours <= set(rows)
    expected = {"wp.Mesh build + any-hit", "wp.Mesh refit + any-hit"}
    for peer, method in (("Embree", "Embree build + occluded"), ("Open3D", "Open3D build + test_occlusions")):
        if peer not in rivals.missing():
            expected.add(method)
    assert {name for name in rows if "/" not in name} == expected
    assert any(name.startswith("brute_force/filtered") for name in rows)
    for name, row in rows.items():
        assert row["dynamic ms"] > 0.0 and row["static ms"] > 0.0
        assert row["wrong rays"] == 0 or name in expected
    assert all(rows[name]["dynamic ratio"] > 0.0 for name in ours)
    assert not found["left_out"]


def test_every_variant_is_measured() -> None:
    settings = replace(_TINY, every=suite_settings.every_variant())
    measured = {row["method"].split(" ")[0] for row in _run("variants", settings)["rows"]}
    assert measured == {f"{name}/{v}" for name, variants in available_pipelines().items() for v in variants}


@pytest.mark.slow
@pytest.mark.parametrize("section", ["rays", "triangles", "lights"])
def test_growth_is_from_row_to_row(section: str) -> None:
    rows = [row for row in _run(section)["rows"] if row["method"] == "light_grid/packed"]
    assert len(rows) == 2
    first, last = rows
    assert first["growth"] is None and last[section] > first[section]
    times, numbers = (last[key] / first[key] for key in ("dynamic ms", section))
    assert last["growth"] == pytest.approx(times / numbers)


def test_finer_shadow_maps_are_less_wrong() -> None:
    rows = _run("maps")["rows"]
    assert [row["map"] for row in rows] == [32, 128]
    assert 0.0 < rows[1]["wrong %"] < rows[0]["wrong %"] < 100.0
    for row in rows:
        assert (row["ms (not exact)"] is None) == (row["rasteriser"] == "numpy")


@pytest.mark.slow
def test_memory_is_that_of_a_process_of_its_own() -> None:
    settings = replace(_TINY, pipelines=(("light_grid", "packed"),), held=(("mesh_bvh", "refit"),))
    rows = {row["method"]: row for row in _run("memory", settings)["rows"]}
    assert {"light_grid/packed", "mesh_bvh/refit", "wp.Mesh"} <= set(rows)
    for row in rows.values():
        assert row["peak MB"] > row["loaded MB"] > 20.0
    assert rows["light_grid/packed"]["device MB"] > 0.0


def test_what_does_not_fit_is_left_out_and_said() -> None:
    found = _run("rays", replace(_TINY, budget={"rays": 0.0}))
    assert found["rows"] == []
    assert found["left_out"] == ["16 x 16", "32 x 32"]
    assert not Clock("rays", 1.0, quiet=True).allows("much", expected=2.0)


class _Liar(rivals.BruteForce):
    """Says the opposite about one sample."""

    def static(self, frame: int) -> Any:
        found = super().static(frame)
        found[0][0] ^= True
        return found


class _Peer(_Liar):
    exact = False


def test_a_wrong_answer_of_ours_stops_the_suite() -> None:
    case = Case(_view(24), 2)
    with pytest.raises(Wrong, match=r"is wrong for 1 rays of frame 0"):
        contest(case, [_Liar("filtered", case, 50)], Effort(1, 0.0))


def test_a_peer_that_is_wrong_has_no_time() -> None:
    case = Case(_view(24), 2)
    (row,) = contest(case, [_Peer("filtered", case, 50)], Effort(1, 0.0))
    assert row["wrong rays"] == 1
    assert row["dynamic ms"] is None and row["static ms"] is None and row["static least ms"] is None
    larger = Case(_view(48), 2)
    assert larger.rays > 1000
    (row,) = contest(larger, [_Peer("filtered", larger, larger.rays)], Effort(1, 0.0))
    assert row["wrong rays"] == 1  # less than one in a thousand: float32 may do that
    assert row["dynamic ms"] > 0.0 and row["static ms"] > 0.0


def test_frames_that_lost_the_processor_do_not_count_if_others_did_not(monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case(_view(24), 2)
    pattern, clock = [1.0, 0.0, 2.0, 0.0, 0.0], [0.0, 0]

    def lost() -> float:
        """Looked at before and after each frame; grows during those that the pattern says."""
        clock[1] += 1
        if clock[1] % 2 == 0:
            clock[0] += pattern[clock[1] // 2 % len(pattern)] if pattern else 5.0
        return clock[0]

    monkeypatch.setattr("contest.stolen", lost)
    (row,) = contest(case, [rivals.BruteForce("filtered", case, 50)], Effort(4, 9.0), static=False)
    # Short frames: up to three times as many as asked for, of four times as many turns.
    assert row["frames"] + row["disturbed"] == 16 and row["disturbed"] == 6
    pattern.clear()
    (row,) = contest(case, [rivals.BruteForce("filtered", case, 50)], Effort(4, 0.0), static=False)
    assert row["frames"] == row["disturbed"] >= 1 and row["dynamic ms"] > 0.0


def test_what_is_lost_only_grows() -> None:
    assert 0.0 <= stolen() <= stolen()


def test_every_frame_has_another_image() -> None:
    case = Case(_view(24), 2)
    first, second = (frame.shot.depth for frame in case.frames)
    seen = np.isfinite(first)
    assert np.array_equal(seen, np.isfinite(second)) and (first != second)[seen].mean() > 0.5


def test_nobody_always_follows_the_same() -> None:
    """What runs before leaves caches and clock as it does: every turn has a separate order, with all methods in it."""
    calls: list[str] = []

    class Quiet:
        exact = False

        def __init__(self, name: str) -> None:
            self.name = name

        def dynamic(self, frame: int) -> None:
            calls.append(self.name)

        def wrong(self, *_: Any) -> int:
            return 0

    case = SimpleNamespace(frames=[None, None], dynamic=[None, None])
    names = list("abcdef")
    effort = Effort(frames=6, seconds=60.0)
    timings = _rounds(case, [Quiet(name) for name in names], "dynamic", effort)  # type: ignore[arg-type]
    assert all(len(timing.times) == 18 for timing in timings.values()), "short frames: three times as many as asked for"
    turns = [calls[first : first + 6] for first in range(0, 36, 6)]
    assert all(sorted(turn) == names for turn in turns)
    for name in names:
        assert len({calls[k - 1] for k in range(1, 36) if calls[k] == name}) > 1


def _row(**given: Any) -> dict[str, Any]:
    row = {"view": "Sponza", "method": "light_grid/packed", "ours": True, "triangles": 10, "rays": 10, "lights": 1}
    return {**row, "dynamic ms": 10.0, "static ms": 5.0, "dynamic ratio": 4.0, "static ratio": 2.0, **given}


def _peer(view: str, method: str, dynamic: float, static: float) -> dict[str, Any]:
    return _row(view=view, method=method, ours=False, **{"dynamic ms": dynamic, "static ms": static})


def _found(sections: dict[str, Any]) -> dict[str, tuple[float, str, str]]:
    """(worst, met, where) by the first words of a target."""
    return {row["target"]: (row["worst"], row["met"], row["where"]) for row in suite_targets.targets(sections)}


def test_targets_take_the_worst_and_auto_for_itself() -> None:
    rows = [
        _row(),
        _row(method="auto/measured", **{"dynamic ms": 15.0, "dynamic ratio": 2.7}),
        _row(method="brute_force/filtered", **{"dynamic ms": 1.0, "dynamic ratio": 30.0}),
        _peer("Sponza", "Embree build + occluded", 60.0, 11.0),
        _peer("Sponza", "wp.Mesh build + any-hit", 40.5, 30.0),
        _peer("Sponza", "wp.Mesh refit + any-hit", 20.0, 30.0),
        _peer("Sponza", "Open3D build + test_occlusions", 45.0, 10.0),
        _row(view="Sibenik"),
        _peer("Sibenik", "Embree build + occluded", 35.0, 20.0),
        _row(view="elsewhere"),
        _peer("elsewhere", "Embree build + occluded", 29.0, 4.0),
    ]
    six, every, static, auto = _found({"scenes": rows}).values()
    assert six == (2.7, "no", "Sponza, 10 triangles, 10 rays, auto/measured")
    assert every[:2] == (2.7, "no") and static[:2] == (0.8, "no") and static[2].startswith("elsewhere")
    assert auto[:2] == (1.5, "no") and auto[2].startswith("Sponza")
    fast_open3d = [*rows, _peer("Sibenik", "Open3D build + test_occlusions", 20.0, 3.0)]
    assert [found[0] for found in _found({"scenes": fast_open3d}).values()] == [2.0, 2.0, 0.6, 1.5]


def test_targets_of_points() -> None:
    few = {"view": "room", "rays": 900}
    rows = [
        _row(rays=2000),
        _row(method="Embree build + occluded", ours=False, rays=2000, **{"dynamic ms": 31.0}),
        _row(**few),
        _row(method="Embree build + occluded", ours=False, **few, **{"dynamic ms": 5.0}),
    ]
    assert [found[:2] for found in _found({"points": rows}).values()] == [(3.1, "yes"), (3.1, "yes")]


def test_targets_of_growth_and_lights() -> None:
    rays = [_row(rays=10), _row(rays=40, **{"dynamic ms": 60.0})]
    lights = [_row(), _row(lights=16, **{"dynamic ms": 90.0})]
    assert [found[0] for found in _found({"rays": rays, "lights": lights}).values()] == [1.5, 9.0]
    peers = [
        _row(method="Open3D build + test_occlusions", ours=False, lights=count, **{"dynamic ms": time})
        for count, time in ((1, 20.0), (16, 81.0))
    ]
    assert [found[:2] for found in _found({"lights": [*lights, *peers]}).values()] == [
        (0.9, "no"),
        (0.9, "no"),
        (9.0, "no"),
    ]


@pytest.mark.slow
def test_points_are_asked_of_all() -> None:
    settings = replace(_TINY, pipelines=suite_settings.choose(["light_grid/packed", "auto"]), asked=((36, 20),))
    rows = _run("points", settings)["rows"]
    assert {row["view"] for row in rows} == {_VIEW, "museum/room/inside"}
    for row in rows:
        assert row["dynamic ms"] > 0.0 and row["static ms"] > 0.0
        assert row["rays"] == 20 or row["view"] == _VIEW
    assert {row["method"] for row in rows} >= {"light_grid/packed", "auto/measured", "wp.Mesh build + any-hit"}


def test_points_are_drawn_with_their_answers() -> None:
    whole = Case(_view(24), 2)
    some = whole.drawn(50)
    for frame, right, of, answers in zip(some.frames, some.dynamic, whole.frames, whole.dynamic, strict=True):
        assert len(frame.points) == len(frame.lights[0].starts) == right.shape[1] == 50
        known = {point.tobytes(): answer for point, answer in zip(of.points, answers[0], strict=True)}
        assert [known[point.tobytes()] for point in frame.points] == right[0].tolist()
        assert not np.array_equal(frame.points, of.points[:50])


@pytest.mark.slow
def test_the_program_writes_figures_and_plots(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="plots need matplotlib")
    done = subprocess.run(
        [sys.executable, "benchmark/suite.py", "--quick", "--sections", "scenes", "--size", "16", "--frames", "1"]
        + ["--seconds", "0", "--views", "robots/grazing/grazing", "--pipelines", "light_grid/packed", "mesh_bvh/refit"]
        + ["--budget", "100", "--out", str(tmp_path)],
        cwd=_ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "| light_grid/packed " in done.stdout
    results = json.loads((tmp_path / "results.json").read_text())
    assert {"processor", "cores", "commit", "warp-lang", "numpy"} <= set(results["machine"])
    assert len(results["sections"]["scenes"]["rows"]) >= 5
    picture = tmp_path / "benchmark_scenes.png"
    assert picture.read_bytes()[:4] == b"\x89PNG" and picture.stat().st_size < 256 * 1024


def test_an_error_loses_no_section_before_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are written after each section, whole: a reader never meets half a file, nor an error a lost one."""
    seen: list[list[str]] = []
    out = tmp_path / "new" / "results.json"

    def section(name: str, error: Exception | None = None) -> Any:
        def measure(settings: Settings, clock: Clock) -> list[dict[str, Any]]:
            seen.append(list(json.loads(out.read_text())["sections"]) if out.exists() else [])
            if error:
                raise error
            return []

        return measure

    monkeypatch.setattr(
        suite,
        "_RUN",
        {"scenes": section("scenes"), "rays": section("rays"), "lights": section("lights", ValueError("17 lights"))},
    )
    monkeypatch.setattr(sys, "argv", ["suite.py", "--out", str(out.parent), "--sections", "scenes", "rays", "lights"])
    with pytest.raises(ValueError, match="17 lights"):
        suite.main()
    assert seen == [[], ["scenes"], ["scenes", "rays"]]
    assert list(json.loads(out.read_text())["sections"]) == ["scenes", "rays"]
    assert [path.name for path in out.parent.iterdir()] == ["results.json"]


def test_what_cannot_be_written_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    suite.write(tmp_path / "results.json", {"sections": {}})
    with pytest.raises(TypeError):
        suite.write(tmp_path / "results.json", {"sections": object()})
    assert [json.loads(path.read_text()) for path in tmp_path.iterdir()] == [{"sections": {}}]


@pytest.mark.slow
def test_plots_of_all_sections_are_small(tmp_path: Path) -> None:
    plots = pytest.importorskip("plots", reason="plots need matplotlib")
    settings = replace(_TINY, pipelines=(("light_grid", "packed"),))
    found = suite.run(settings, ["scenes", "points", "rays", "triangles", "lights", "maps"], quiet=True)
    held = {"triangles": 600, "rays": 500, "device MB": None, "loaded MB": 100.0, "peak MB": 130.0, "more MB": 30.0}
    found["memory"] = {"rows": [{**held, "method": method} for method in ("light_grid/packed", "Embree")]}
    machine = {"processor": "p", "warp-lang": "1", "embreex": "4", "commit": "c", "changed since": False}
    made = plots.draw({"machine": machine, "threads": 1, "sections": found}, tmp_path)
    assert len(made) == 4 and all(0 < path.stat().st_size < 256 * 1024 for path in made)


def test_recordings_need_the_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SHADOW_TRACER_DATA", str(tmp_path))
    assert list(views(32, ["livingroom1", "Sponza"])) == []


@pytest.mark.parametrize("sequence", ["livingroom1", "redkitchen"])
def test_recordings_are_frames_of_their_own(sequence: str) -> None:
    pytest.importorskip("PIL", reason="recorded depth images need Pillow")
    found = list(views(32, [sequence]))
    if not found:
        pytest.skip("real data: set SHADOW_TRACER_DATA; this test on recorded depth images is not run")
    case = Case(found[0], 2)
    assert case.frames[0].shot.depth.shape == (30, 40)
    assert 0.05 < case.in_shadow < 0.95
    first, second = (frame.shot.camera.camera_to_world for frame in case.frames)
    assert not np.array_equal(first, second)


def test_more_lights_than_the_default_bound_are_measured() -> None:
    settings = replace(_TINY, pipelines=(("light_grid", "packed"),), lights=(Bounds().max_lights + 1,))
    rows = suite.run(settings, ["lights"], quiet=True)["lights"]["rows"]
    ours = [row for row in rows if row["method"] == "light_grid/packed"]
    assert [row["lights"] for row in ours] == [17] and ours[0]["dynamic ms"] > 0.0
