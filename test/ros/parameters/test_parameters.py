# SPDX-License-Identifier: Apache-2.0
"""The parameter table: defaults, conversions, every kind of bad value, misspelt names, the YAML file."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import lamps
import numpy as np
import pytest

from shadow_tracer import (
    Bias,
    Bounds,
    DirectionalLight,
    DiscLight,
    IntensityTable,
    PointLight,
    RectangleLight,
    SpotLight,
    SunDisc,
    TubeLight,
    available_pipelines,
)
from shadow_tracer.ros.parameters import parameters
from shadow_tracer.ros.parameters.former_names import renamed
from shadow_tracer.ros.parameters.parameters import ParameterError, problems_in, settings_from, unknown_names

ROOT = Path(__file__).parents[3]


def test_defaults_make_settings() -> None:
    settings = settings_from({})
    assert settings.pipeline == "light_grid" and settings.tracer_device is None
    assert settings.bounds == Bounds()
    assert settings.bias == Bias(0.02, 0.003, 0.6)
    assert [light.name for light in settings.enabled_lights] == ["lamp"]
    assert not settings.needs_tf


BAD = [
    (
        "pipeline",
        "cone",
        f"pipeline: expected string ({', '.join(available_pipelines())}), got 'cone'",
    ),
    ("pipeline", 3, "pipeline: expected string"),
    ("variant", "fast", "variant: expected string"),
    ("variant", "float64", "variant: expected one of packed, spherical"),
    ("device", "gpu", "device: expected string (auto, cpu, cuda:N), got 'gpu'"),
    ("device", "cuda", "device: expected string"),
    ("threads", -1, "threads: expected integer (0 to 64), got -1"),
    ("threads", 1.5, "threads: expected integer"),
    ("fixed_frame", "/map", 'fixed_frame: expected string (a tf frame without leading "/"'),
    ("fixed_frame", "my map", "fixed_frame: expected string"),
    ("fixed_frame", 1, "fixed_frame: expected string"),
    ("pose_source", "odom", "pose_source: expected string (tf, topic, parameter), got 'odom'"),
    ("camera_frame", "/camera", 'camera_frame: expected string (a tf frame without leading "/"'),
    ("camera_frame", "my camera", "camera_frame: expected string"),
    ("camera_pose", [0.0, 0.0, 1.0], "camera_pose: expected double array (7 numbers), got (0.0, 0.0, 1.0)"),
    ("camera_pose", [0, 0, 0, 0, 0, 0, 0], "camera_pose: expected a unit quaternion"),
    ("camera_pose", [0, 0, math.nan, 0, 0, 0, 1], "camera_pose: expected double array"),
    ("camera_pose", "0 0 0 0 0 0 1", "camera_pose: expected double array"),
    ("tf_timeout", -0.1, "tf_timeout: expected double (0 to 10 s), got -0.1"),
    ("tf_timeout", 11, "tf_timeout: expected double (0 to 10 s), got 11"),
    ("mesh.frame", "a b", "mesh.frame: expected string"),
    ("mesh.max_age", math.inf, "mesh.max_age: expected double (0 to 1000000 s), got inf"),
    ("mesh.files", "part.stl", "mesh.files: expected string array, got 'part.stl'"),
    ("mesh.files", [1], "mesh.files: expected string array"),
    ("mesh.files_scale", -0.001, "mesh.files_scale: expected double (0 to 1000000 m), got -0.001"),
    ("depth_image_transport", "compressed", "depth_image_transport: expected string (raw, compressedDepth), got"),
    ("depth_image_transport", "", "depth_image_transport: expected string (raw, compressedDepth), got ''"),
    ("depth.unit", 0.0, "depth.unit: expected double (1e-06 to 1 m), got 0.0"),
    ("depth.unit", 1000, "depth.unit: expected double (1e-06 to 1 m), got 1000"),
    ("occluders", "both", "occluders: expected string (mesh, depth, mesh+depth), got 'both'"),
    ("depth_occluder.step", 0, "depth_occluder.step: expected integer (1 to 16 px), got 0"),
    ("depth_occluder.step", 1.5, "depth_occluder.step: expected integer"),
    ("depth_occluder.max_jump", 1.01, "depth_occluder.max_jump: expected double ("),
    ("camera_info_policy", "nearest", "camera_info_policy: expected string (auto, exact, latest)"),
    ("distortion", "yes", "distortion: expected string (auto, apply, ignore), got 'yes'"),
    ("distortion", True, "distortion: expected string (auto, apply, ignore), got True"),
    ("light_names", "lamp", "light_names: expected string array"),
    ("light_names", ["lamp", "lamp"], "light_names: expected different names"),
    ("light_names", ["my lamp"], "light_names: expected names of letters, digits"),
    ("light_names", ["a__b"], "light_names: expected names"),
    ("light_names", ["1st"], "light_names: expected names"),
    ("light_names", ["camera_info"], "light_names: expected names of letters, digits and single underscores, a letter"),
    ("light_names", [1, 2], "light_names: expected string array"),
    ("light_names", [f"l{k}" for k in range(17)], "light_names: expected at most bounds.max_lights = 16 names, got 17"),
    ("camera_names", "front", "camera_names: expected string array"),
    ("camera_names", ["front", "front"], "camera_names: expected different names, got ['front', 'front']"),
    ("camera_names", ["dose"], "camera_names: expected names of letters, digits and single underscores, a letter"),
    ("camera_names", [f"c{k}" for k in range(17)], "camera_names: expected at most 16 names, got 17"),
    ("camera_names", ["front", "rear"], "fixed_frame: expected the frame in which the cameras front, rear and"),
    ("bias.constant", math.nan, "bias.constant: expected double (0 to 1 m), got nan"),
    ("bias.constant", True, "bias.constant: expected double (0 to 1 m), got True"),
    ("bias.constant", "0.1", "bias.constant: expected double (0 to 1 m), got '0.1'"),
    ("bias.quadratic", -1.0, "bias.quadratic: expected double (0 to 0.1 1/m), got -1.0"),
    ("bias.normal", -0.1, "bias.normal: expected double (0 to 2), got -0.1"),
    ("bias.normal", 2.1, "bias.normal: expected double (0 to 2), got 2.1"),
    ("bias.normal", math.inf, "bias.normal: expected double (0 to 2), got inf"),
    ("bias.normal", "on", "bias.normal: expected double (0 to 2), got 'on'"),
    ("front_face_culling", "on", "front_face_culling: expected bool, got 'on'"),
    ("mask.unknown_value", 255, "mask.unknown_value: expected integer (0 to 254), got 255"),
    ("mask.unknown_value", 1.0, "mask.unknown_value: expected integer"),
    ("mask.publish", "never", "mask.publish: expected string (listened, always), got 'never'"),
    ("mask.dilate", 65, "mask.dilate: expected integer (0 to 64 px), got 65"),
    ("mask.dilate", -1, "mask.dilate: expected integer (0 to 64 px), got -1"),
    ("mask.invert", 1, "mask.invert: expected bool"),
    ("markers.max_triangles", -1, "markers.max_triangles: expected integer (0 to 1000000), got -1"),
    ("process", "all", "process: expected string (latest, every), got 'all'"),
    ("verify_every", -1, "verify_every: expected integer (0 to 1000000), got -1"),
    ("verify_every", True, "verify_every: expected integer"),
    ("bounds.max_triangles", 0, "bounds.max_triangles: expected integer (1 to 178948778), got 0"),
    ("bounds.max_rays", 2**40, "bounds.max_rays: expected integer"),
    ("bounds.max_rays", 2**27, "bounds.max_rays: expected at most 1610612736 for max_rays * max_lights"),
    ("bounds.max_lights", 65, "bounds.max_lights: expected integer (1 to 64), got 65"),
    ("bounds.queue_capacity", 2**30 + 1, "bounds.queue_capacity: expected integer (1 to 1073741824)"),
    ("bounds.grid_entries", 0, "bounds.grid_entries: expected integer (1 to 1073741823), got 0"),
    ("grid_map.layer", "", "grid_map.layer: expected string (a name of 1 to 200 characters), got ''"),
    ("grid_map.height_above", 0.0, "grid_map.height_above: expected double (0.001 to 100 m), got 0.0"),
    ("grid_map.dark_value", 0, "grid_map.dark_value: expected integer (1 to 100), got 0"),
    ("grid_map.period", 0.1, "grid_map.period: expected double (0.25 to 3600 s), got 0.1"),
    ("sun_map.hours", 0.0, "sun_map.hours: expected double (0.25 to 744 h), got 0.0"),
    ("sun_map.step", math.nan, "sun_map.step: expected double (1 to 240 min), got nan"),
    ("sun_map.period", 0.0, "sun_map.period: expected double (0.25 to 86400 s), got 0.0"),
    ("diagnostics_period", 0.0, "diagnostics_period: expected double (0.02 to 1 s), got 0.0"),
    (
        "lights.lamp.type",
        "laser",
        "lights.lamp.type: expected string (point, spot, directional, sun, sphere, disc, rectangle, tube), got 'laser'",
    ),
    ("lights.lamp.enabled", "yes", "lights.lamp.enabled: expected bool, got 'yes'"),
    ("lights.lamp.enabled", 1, "lights.lamp.enabled: expected bool, got 1"),
    ("lights.lamp.frame", "/lamp", "lights.lamp.frame: expected string"),
    ("lights.lamp.position", [1.0, 2.0], "lights.lamp.position: expected double array (3 numbers [m]), got (1.0, 2.0)"),
    ("lights.lamp.direction", [0, 0, 0], "lights.lamp.direction: expected a length from 1e-6 to 1e6"),
    ("lights.lamp.outer_angle", 4.0, "lights.lamp.outer_angle: expected double (0.001 to pi rad), got 4.0"),
    ("lights.lamp.range", -1.0, "lights.lamp.range: expected double (0 to 1000000000 m), got -1.0"),
    ("lights.lamp.radius", -0.1, "lights.lamp.radius: expected double (0 to 1000000 m), got -0.1"),
    ("lights.lamp.axis", [0, 0, 0], "lights.lamp.axis: expected a length from 1e-6 to 1e6"),
    ("lights.lamp.axis", [1, 0], "lights.lamp.axis: expected double array (3 numbers)"),
    ("lights.lamp.length", 0.0, "lights.lamp.length: expected double (1e-06 to 1000000 m), got 0.0"),
    ("lights.lamp.size", [0.5, 0.0], "lights.lamp.size: expected two sides from 1e-06 to 1e+06 m, got [0.5, 0.0]"),
    ("lights.lamp.size", [0.5], "lights.lamp.size: expected double array (2 numbers [m])"),
    ("lights.lamp.two_sided", 1, "lights.lamp.two_sided: expected bool, got 1"),
    ("dose.parts", "mesh", "dose.parts: expected string array, got 'mesh'"),
    ("dose.target", 0.0, "dose.target: expected double (1e-06 to 1e+12 J/m2)"),
    ("dose.goal", 1.5, "dose.goal: expected double (0 to 1), got 1.5"),
    ("dose.max_edge", 0.0, "dose.max_edge: expected double (0.0001 to 1000 m)"),
    ("dose.side", "top", "dose.side: expected string (front, back, both), got 'top'"),
    ("dose.folder", 3, "dose.folder: expected string, got 3"),
    ("lights.lamp.power", -1.0, "lights.lamp.power: expected double (0 to 1000000000 W)"),
    ("lights.lamp.intensity", "3", "lights.lamp.intensity: expected double (0 to 1000000000 W/sr)"),
    ("lights.lamp.exitance", 1.0, "lights.lamp.exitance: a PointLight has none; expected power or intensity"),
    ("lights.lamp.irradiance", 1.0, "lights.lamp.irradiance: a PointLight has none; expected power or intensity"),
    ("lights.lamp.model", "phong", "lights.lamp.model: expected string ("),
    ("lights.lamp.ies.file", "/nowhere.ies", "lights.lamp.ies.file: cannot find '/nowhere.ies': No such file"),
    ("lights.lamp.ies.unit", "candela", 'lights.lamp.ies.unit: expected string ("", W/sr, mW/sr, uW/cm2 at 1 m, cd)'),
    ("lights.lamp.ies.lumens_per_watt", 700.0, "lights.lamp.ies.lumens_per_watt: expected double (0 to 683.1 lm/W)"),
    ("lights.lamp.output", 1.1, "lights.lamp.output: expected double (0 to 1), got 1.1"),
    ("lights.lamp.angular_diameter", 1.6, "lights.lamp.angular_diameter: expected double (0 to"),
    ("mesh.cast_no_shadows", "mesh", "mesh.cast_no_shadows: expected string array, got 'mesh'"),
    ("lights.lamp.ignore", "shade", "lights.lamp.ignore: expected string array, got 'shade'"),
    ("lights.lamp.sun.latitude", 90.5, "lights.lamp.sun.latitude: expected double (-90 to 90 deg), got 90.5"),
    ("lights.lamp.sun.longitude", -181.0, "lights.lamp.sun.longitude: expected double (-180 to 180 deg), got -181.0"),
    ("lights.lamp.sun.time", "noon", "lights.lamp.sun.time: expected a time in ISO 8601 such as 2026-06-21T12:00:00Z"),
    ("lights.lamp.sun.time", 12, "lights.lamp.sun.time: expected string, got 12"),
    ("lights.lamp.sun.time", "1850-01-01", "lights.lamp.sun.time: expected the years 1900 to 2100"),
]


@pytest.mark.parametrize(("name", "value", "message"), BAD, ids=[f"{name}={value!r}"[:60] for name, value, _ in BAD])
def test_bad_values_are_refused_with_their_name(name: str, value: Any, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        settings_from({name: value})
    assert message in str(caught.value)
    assert any(message in problem for problem in problems_in({name: value}))


BAD_OF_CAMERA = [
    ("depth_topic", "a b", "expected string (a topic such as"),
    ("depth_topic", "a__b/image", "expected string (a topic such as"),
    ("depth_topic", "rear/depth/image_rect", "expected another topic than that of camera rear, got"),
    ("info_topic", "/info/", "expected string (a topic such as"),
    ("pose_topic", 3, "expected string (a topic such as"),
    ("transport", "", "expected string (raw, compressedDepth), got ''"),
    ("frame", "/front", 'expected string (a tf frame without leading "/"'),
    ("pose", [0, 0, 0, 0, 0, 0, 0], "expected a unit quaternion"),
    ("rate", -1, "expected double (0 to 1000 Hz), got -1"),
    ("bias.constant", 1.5, "expected double (-1 to 1 m), got 1.5"),
    ("bias.constant", -0.1, "expected -1 (as bias.constant) or at least 0, got -0.1"),
    ("bias.quadratic", -0.5, "expected -1 (as bias.quadratic) or at least 0, got -0.5"),
    ("bias.normal", math.nan, "expected double (-1 to 2), got nan"),
]
TWO_CAMERAS = {"camera_names": ["rear", "front"], "fixed_frame": "map"}


@pytest.mark.parametrize(("key", "value", "message"), BAD_OF_CAMERA)
def test_bad_values_of_a_camera_are_refused_with_their_name(key: str, value: Any, message: str) -> None:
    values = TWO_CAMERAS | {f"cameras.front.{key}": value}
    with pytest.raises(ParameterError) as caught:
        settings_from(values)
    assert str(caught.value).startswith(f"cameras.front.{key}: {message}")
    assert any(message in problem for problem in problems_in(values))


def test_settings_of_a_camera() -> None:
    given = {"cameras.front.bias.constant": 0.0, "bias.normal": 0.2, "cameras.front.rate": 5, "camera_frame": "other"}
    given |= {"cameras.rear.frame": "back", "cameras.rear.depth_topic": "/r/image"}
    settings = settings_from(TWO_CAMERAS | given)
    assert settings.camera_names == ("rear", "front") and settings.bounds.max_sample_sets == 2
    assert settings.samples == settings.of("rear").samples == "rear" and settings.of("front").samples == "front"
    assert settings.of("front").bias == Bias(0.0, 0.003, 0.2) and settings.of("rear").bias == Bias(0.02, 0.003, 0.2)
    assert settings.of("front").camera_rate == 5.0 and settings.of("front").of("rear") == settings.of("rear")
    assert [settings.of(name).camera_frame for name in settings.camera_names] == ["back", ""]
    topics = [(camera.depth_topic, camera.info_topic, camera.pose_topic) for camera in settings.cameras]
    assert topics[0] == ("/r/image", "/r/camera_info", "rear/camera_pose")
    assert topics[1] == ("front/depth/image_rect", "front/depth/camera_info", "front/camera_pose")
    assert settings_from({}).camera_names == ("",) and settings_from({}).of("").samples == ""
    for fixed in ({"pose_source": "topic", "fixed_frame": ""}, {"camera_names": ["front"], "fixed_frame": ""}):
        assert settings_from(TWO_CAMERAS | fixed).cameras


def test_every_parameter_has_a_bad_value_above() -> None:
    assert {key for key, _, _ in BAD_OF_CAMERA} == {row.name for row in parameters.CAMERA_PARAMETERS}
    assert {name.replace("lights.lamp.", "lights.<name>.") for name, _, _ in BAD} == {
        *(row.name for row in parameters.PARAMETERS),
        *(f"lights.<name>.{row.name}" for row in parameters.LIGHT_PARAMETERS),
    }


def test_ies_files_that_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each with the parameter that helps."""
    pytest.importorskip("photompy")
    (tmp_path / "broken.ies").write_text("IESNA:LM-63-2002\nTILT=NONE\n1 2\n")
    good = {"ies.file": str(lamps.ies(tmp_path)), "ies.unit": "mW/sr"}
    assert settings_from({f"lights.lamp.{key}": value for key, value in good.items()}).lights[0].strength
    for change, message in (
        ({"ies.unit": ""}, "ies.unit: expected one of 'W/sr', 'mW/sr', 'uW/cm2 at 1 m', 'cd', got ''"),
        ({"ies.unit": "cd"}, "ies.lumens_per_watt: candela need it"),
        ({"ies.lumens_per_watt": 300.0}, "ies.lumens_per_watt: belongs to the unit 'cd' alone"),
        ({"ies.file": str(tmp_path / "broken.ies")}, "ies.file: expected a file of IES LM-63"),
        ({"ies.file": str(tmp_path)}, f"ies.file: {tmp_path} is not a file"),
        ({"ies.file": "package://no_such_package/lamp.ies"}, "ies.file: there is no package 'no_such_package'"),
        ({"ies.file": "http://lamp.ies"}, "ies.file: expected a path, file:///... or package://..."),
        ({"model": "lambert"}, "model: expected '' beside ies.file, got 'lambert'"),
        ({"power": 1.0, "intensity": 1.0}, "intensity: expected 0 beside power, got both"),
        ({"type": "sun"}, "ies.file: expected None of a DirectionalLight, got a table"),
        ({"axis": [0, 0, -3]}, "axis: expected another line than direction [0.0, 0.0, 1.0] for ies.file"),
    ):
        with pytest.raises(ParameterError) as caught:
            settings_from({f"lights.lamp.{key}": value for key, value in {**good, **change}.items()})
        assert str(caught.value).startswith(f"lights.lamp.{message}")
    monkeypatch.setitem(sys.modules, "photompy", None)
    (tmp_path / "other").mkdir()
    with pytest.raises(ParameterError, match=r"ies.file: IES files need photompy: pip install .*\[photometry\]"):
        settings_from({"lights.lamp.ies.file": str(lamps.ies(tmp_path / "other")), "lights.lamp.ies.unit": "W/sr"})


def test_an_ies_file_hangs_as_its_light_does(tmp_path: Path) -> None:
    """Vertical angles count from direction, horizontal ones from axis, in whatever frame; the same file is the same
    table, and another one under its name is another."""
    pytest.importorskip("photompy")
    path = lamps.ies(tmp_path, (0, 90, 180, 270, 360), [[9, 1, 0], [9, 2, 0], [9, 3, 0], [9, 4, 0], [9, 1, 0]])
    values = {
        "lights.lamp.ies.file": str(path), "lights.lamp.ies.unit": "W/sr", "lights.lamp.power": 7.0,
        "lights.lamp.output": 0.5, "lights.lamp.direction": [0, 2, 0], "lights.lamp.axis": [3, 1, 0],
    }  # fmt: skip
    light = settings_from(values).lights[0]
    assert light.strength is not None and light.strength.power == 7.0 and light.strength.output == 0.5
    turned = np.array([[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]])
    for pose in (np.eye(4), turned):
        made = light.light(pose)
        assert made.strength is not None and isinstance(made.strength.model, IntensityTable)
        ways = np.array([(0.0, 9.0, 0.0), (3.0, 3.0, 0.0), (-2.0, 2.0, 0.0), (0.0, 4.0, -4.0), (0.0, 1.0, 1.0)])
        found = made.strength.model.towards(ways @ pose[:3, :3].T)
        # Seen against direction, from ahead of the light, angles grow from axis counter-clockwise.
        assert found == pytest.approx([9.0, 1.0, 3.0, 4.0, 2.0])
    again = settings_from({**values, "lights.lamp.output": 1.0}).lights[0].strength
    assert again is not None and again.model is light.strength.model
    other = lamps.ies(tmp_path, values=[[8, 1, 0]])
    os.utime(other, ns=(0, 0))
    changed = settings_from(values).lights[0].strength
    assert changed is not None and isinstance(changed.model, IntensityTable) and changed.model.peak == 8.0


def test_all_problems_come_at_once() -> None:
    problems = problems_in({"bias.constant": -1.0, "pose_source": "gps", "lights.lamp.type": "laser", "unrelated": 3})
    assert len(problems) == 3
    assert {problem.split(":")[0] for problem in problems} == {"bias.constant", "pose_source", "lights.lamp.type"}


def test_integers_are_accepted_for_doubles() -> None:
    settings = settings_from(
        {"bias.constant": 1, "camera_pose": [1, 2, 3, 0, 0, 0, 1], "lights.lamp.position": np.arange(3)}
    )
    assert settings.bias_constant == 1.0 and isinstance(settings.bias_constant, float)
    assert settings.camera_pose[:3] == (1.0, 2.0, 3.0)
    assert settings.lights[0].position == (0.0, 1.0, 2.0)


@pytest.mark.parametrize(
    ("kind", "group", "message"),
    [
        ("sphere", {"radius": 0.0}, "lights.lamp.radius: expected at least 1e-06 m for type sphere, got 0"),
        ("disc", {"radius": 1e-7}, "lights.lamp.radius: expected at least 1e-06 m for type disc, got 1e-07"),
        ("rectangle", {"axis": [0, 0, -3]}, "lights.lamp.axis: expected another line than direction [0.0, 0.0, 1.0]"),
    ],
)
def test_what_does_not_fit_the_type_is_refused(kind: str, group: dict[str, Any], message: str) -> None:
    values = {f"lights.lamp.{key}": value for key, value in group.items()}
    assert settings_from(values)  # not asked of a point light
    with pytest.raises(ParameterError) as caught:
        settings_from({**values, "lights.lamp.type": kind})
    assert str(caught.value).startswith(message)


def test_lights_with_a_size_are_what_their_parameters_say() -> None:
    values = {
        "light_names": ["disc", "panel", "tube", "line", "sky", "sun"],
        "lights.disc.type": "disc",
        "lights.disc.radius": 0.25,
        "lights.panel.type": "rectangle",
        "lights.panel.size": [2, 1],
        "lights.panel.axis": [3, 0, 7],  # what lies along direction does not count
        "lights.panel.two_sided": True,
        "lights.panel.ignore": ["markers/panel", ""],
        "lights.tube.type": "tube",
        "lights.tube.position": [1, 2, 3],
        "lights.tube.axis": [0, 0, 5],
        "lights.tube.length": 2.0,
        "lights.tube.range": 4.0,
        "lights.line.type": "tube",
        "lights.line.radius": 0.0,
        "lights.sky.type": "directional",
        "lights.sky.angular_diameter": 0.0093,
        "lights.sun.type": "directional",
    }
    disc, panel, tube, line, sky, sun = (light.light(np.eye(4)) for light in settings_from(values).lights)
    assert isinstance(disc, DiscLight) and (disc.radius, disc.two_sided, disc.range) == (0.25, False, math.inf)
    assert isinstance(panel, RectangleLight) and panel.two_sided and panel.ignore == ("markers/panel",)
    np.testing.assert_allclose([panel.u, panel.v, panel.normal], [(1, 0, 0), (0, 0.5, 0), (0, 0, 1)], atol=1e-12)
    assert isinstance(tube, TubeLight) and (tube.radius, tube.range) == (0.1, 4.0)
    np.testing.assert_array_equal([tube.start, tube.end], [(1, 2, 2), (1, 2, 4)])
    assert isinstance(line, TubeLight) and line.radius == 0.0 and line.ignore == ()
    assert isinstance(sky, SunDisc) and sky.angular_diameter == 0.0093
    assert isinstance(sun, DirectionalLight)


@pytest.mark.parametrize("empty", [[], [""], ()])
def test_no_lights(empty: Any) -> None:
    assert settings_from({"light_names": empty}).lights == ()


def test_lights_become_lights_of_the_library() -> None:
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = (10, 0, 0)
    values = {
        "light_names": ["p", "s", "d"],
        "lights.s.type": "spot",
        "lights.d.type": "directional",
        "lights.p.range": 3.0,
        "lights.p.position": [1, 0, 0],
        "lights.s.direction": [2, 0, 0],
        "lights.d.direction": [1, 0, 0],
    }
    point, spot, directional = (light.light(pose) for light in settings_from(values).lights)
    assert isinstance(point, PointLight) and point.range == 3.0
    np.testing.assert_array_equal(point.position, (10, 1, 0))
    assert isinstance(spot, SpotLight) and math.isinf(spot.range) and spot.outer_angle == 0.5
    np.testing.assert_array_equal(spot.direction, (0, 2, 0))
    assert isinstance(directional, DirectionalLight)
    np.testing.assert_array_equal(directional.direction, (0, 1, 0))


@pytest.mark.parametrize(
    ("values", "needed"),
    [
        ({}, False),
        ({"fixed_frame": "map"}, True),
        ({"fixed_frame": "map", "pose_source": "parameter"}, False),
        ({"fixed_frame": "map", "pose_source": "topic", "mesh.frame": "map"}, False),
        ({"fixed_frame": "map", "pose_source": "topic", "mesh.frame": "odom"}, True),
        ({"fixed_frame": "map", "pose_source": "topic", "lights.lamp.frame": "tool"}, True),
        ({"pose_source": "topic", "lights.lamp.frame": "tool", "lights.lamp.enabled": False}, False),
    ],
)
def test_tf_is_only_listened_to_when_needed(values: dict[str, Any], needed: bool) -> None:
    assert settings_from(values).needs_tf is needed


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("bias.constnt", "did you mean bias.constant?"),
        ("biasconstant", "did you mean bias.constant?"),
        ("lights.lamp.postion", "did you mean lights.lamp.position?"),
        ("lights.lmap.position", "'lmap' is not in light_names ['lamp']"),
        ("camera_info_polcy", "did you mean camera_info_policy?"),
        ("xyzzy", "see the parameter table"),
    ],
)
def test_misspelt_names_get_the_nearest_known_one(name: str, hint: str) -> None:
    warnings = unknown_names([name, "bias.constant"], parameters.names_for(["lamp"]), ["lamp"])
    assert len(warnings) == 1 and warnings[0].startswith(name) and hint in warnings[0]


def test_no_parameter_is_a_prefix_of_another_at_a_dot() -> None:
    """`ros2 param dump` and nested YAML make groups of what stands before a dot: a value cannot be a group too."""
    names = [*parameters.names_for(["lamp", "l2"]), "use_sim_time"]
    assert len(set(names)) == len(names)
    assert [(a, b) for a in names for b in names if b.startswith(f"{a}.")] == []


@pytest.mark.parametrize("value", [["a", "b"], ("a",), [], [""]], ids=str)
def test_the_former_name_of_the_list_of_lights_is_taken_with_a_warning(value: Any) -> None:
    values, warnings = renamed({"tf_timeout": 0.1, "lights": value, "lights.a.type": "spot"})
    assert list(values.items()) == [("tf_timeout", 0.1), ("light_names", value), ("lights.a.type", "spot")]
    assert len(warnings) == 1
    written = warnings[0].partition("write ")[2].partition(" (")[0]
    yaml = pytest.importorskip("yaml")
    assert yaml.safe_load(written) == {"light_names": list(value)}
    assert [light.name for light in settings_from(values).lights] == [name for name in value if name]


def test_both_names_of_the_list_of_lights() -> None:
    assert renamed({"light_names": ["a"], "lights": ("a",)})[0] == {"light_names": ("a",)}
    with pytest.raises(ParameterError, match=r"lights: expected only light_names.*got \[b\] beside light_names: \[a\]"):
        renamed({"light_names": ["a"], "lights": ["b"]})
    with pytest.raises(ParameterError, match="light_names: expected string array .*got 'lamp'"):
        settings_from(renamed({"lights": "lamp"})[0])


def test_default_yaml_is_the_table() -> None:
    yaml = pytest.importorskip("yaml")
    values = yaml.safe_load((ROOT / "config" / "default.yaml").read_text())["/**"]["ros__parameters"]
    assert list(values) == sorted(values, key=list(values).index)
    assert set(values) == set(parameters.names_for(["lamp"]))
    for name, value in values.items():
        row = parameters.row_of(name)
        assert row is not None
        default = list(row.default) if isinstance(row.default, tuple) else row.default
        assert value == default and type(value) is type(default), name


def test_markdown_table() -> None:
    text = parameters.markdown_table()
    assert text.count("\n") == 2 + sum(
        map(len, (parameters.PARAMETERS, parameters.CAMERA_PARAMETERS, parameters.LIGHT_PARAMETERS))
    )
    for line in text.splitlines():
        assert line.replace("\\|", "").count("|") == 6
    assert "| `bias.constant` | double | `0.02` | 0 to 1 m |" in text
    assert "Read-only: device buffers of this size are allocated once" in text
    run = subprocess.run(
        [sys.executable, "-m", "shadow_tracer.ros.parameters"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout == text and run.stderr == ""
