# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the node, declared once: type, default, unit, range and meaning. No ROS here.

``python -m shadow_tracer.ros.parameters`` prints the table as Markdown, as it stands in docs/node.md.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from shadow_tracer import Bounds, available_pipelines
from shadow_tracer.ros.cameras.camera_infos import POLICIES
from shadow_tracer.ros.parameters.camera_parameters import (
    CAMERA_NAMES,
    CAMERA_PARAMETERS,
    camera_names,
    cameras_from,
    check_rotation,
)
from shadow_tracer.ros.parameters.light_parameters import FRAME, FRAME_TEXT, LIGHT_PARAMETERS, light_from
from shadow_tracer.ros.parameters.parameter_rows import (
    BOOL,
    DOUBLE,
    DOUBLES,
    INTEGER,
    NAME,
    NAME_TEXT,
    STRING,
    STRINGS,
    Parameter,
    ParameterError,
    convert,
    convert_names,
)
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.messages import DISTORTION, MILLIMETRE
from shadow_tracer.scene.bounds import LIMITS
from shadow_tracer.scene.texels import SIDES

__all__ = [
    "CAMERA_PARAMETERS",
    "LIGHT_PARAMETERS",
    "PARAMETERS",
    "Parameter",
    "ParameterError",
    "camera_names",
    "convert",
    "default_of",
    "light_names",
    "markdown_table",
    "names_for",
    "names_in",
    "problems_in",
    "row_of",
    "settings_from",
    "unknown_names",
]

_BUFFER = "device buffers of this size are allocated once, at start; restart the node to change it"
_DEVICE = "buffers and kernels live on one device from the start; restart the node to change it"
_THREADS = "buffers are cut into as many bands at the start; restart the node to change it"
_DEVICE_NAME = re.compile(r"auto|cpu|cuda:\d+")
_LAYER = re.compile(r".{1,200}", re.DOTALL)
_NO_LIGHTS = ("camera_info",)  # ~/mask/camera_info is the camera_info of all masks


def _pipelines() -> tuple[str, ...]:
    return tuple(available_pipelines())


def _variants() -> tuple[str, ...]:
    return ("", *dict.fromkeys(variant for variants in available_pipelines().values() for variant in variants))


PARAMETERS: tuple[Parameter, ...] = (
    Parameter("pipeline", STRING, "light_grid",
              "How shadows are found; auto chooses for each frame by what frames have cost. All give the same masks.",
              allowed=_pipelines()),
    Parameter("variant", STRING, "",
              "Variant of the pipeline; empty is the pipeline's default.", allowed=_variants()),
    Parameter("device", STRING, "auto",
              "Where kernels run; auto takes the first CUDA device, or the CPU if there is none.",
              pattern=_DEVICE_NAME, pattern_text="auto, cpu, cuda:N", read_only=_DEVICE),
    Parameter("threads", INTEGER, 0,
              "How many cores of the CPU a frame may keep busy; 0 is all that the node may use, at most 8.",
              low=0, high=64, read_only=_THREADS),
    Parameter("fixed_frame", STRING, "",
              "World frame of meshes and lights. Empty: with pose_source tf the world is the optical frame of the "
              "depth image and needs no tf; with the other sources it is the frame their poses are given in.",
              pattern=FRAME, pattern_text=FRAME_TEXT),
    Parameter("pose_source", STRING, "tf",
              "Where the pose of the camera's optical frame in fixed_frame comes from: tf (at the stamp of the "
              "image), the topic camera_pose, or the parameter camera_pose.", allowed=("tf", "topic", "parameter")),
    Parameter("camera_frame", STRING, "",
              "Optical frame of the depth image, where its header names another one or none; empty is that of the "
              "header.", pattern=FRAME, pattern_text=FRAME_TEXT),
    Parameter("camera_pose", DOUBLES, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
              "Pose of the optical frame, x y z [m] qx qy qz qw, used when pose_source is parameter.", length=7),
    Parameter("tf_timeout", DOUBLE, 0.2,
              "How long a frame waits for its transforms, camera pose and camera_info before its mask says unknown; "
              "a camera_pose farther than this from the stamp of the image is not used.", "s", 0.0, 10.0),
    Parameter("mesh.frame", STRING, "",
              "Frame of the topic mesh, which has no header; empty is fixed_frame.",
              pattern=FRAME, pattern_text=FRAME_TEXT),
    Parameter("mesh.max_age", DOUBLE, 0.0,
              "A mesh received longer ago than this is stale and the mask says unknown; 0 never.", "s", 0.0, 1e6),
    Parameter("mesh.files", STRINGS, ("",),
              "Mesh files in mesh.frame (STL, OBJ, PLY, OFF, glTF, COLLADA, 3MF and more), their axes as written: "
              "paths, file:// or package://<package>/...; [''] is none."),
    Parameter("mesh.files_scale", DOUBLE, 0.0,
              "Length of a file's unit; 0 takes the unit that is written in the file, or metres.", "m", 0.0, 1e6),
    Parameter("mesh.cast_no_shadows", STRINGS, ("",),
              "Parts that cast no shadow in any light, named as in lights.<name>.ignore: glass, nets, marks. They are "
              "drawn, have normals and receive a dose as before. [''] is none."),
    Parameter("depth_image_transport", STRING, "raw",
              "raw takes images from depth/image_rect, compressedDepth packed ones (PNG, RVL) from "
              "depth/image_rect/compressedDepth.", allowed=("raw", "compressedDepth")),
    Parameter("depth.unit", DOUBLE, MILLIMETRE,
              "Length of a step of 16UC1 and mono16. Other than 0.001: a depth is step * unit, rounded to float32.",
              "m", 1e-6, 1.0),
    Parameter("occluders", STRING, "mesh",
              "What casts shadow: received meshes, grid maps and mesh files, the surface that the depth image itself "
              "shows, or both.", allowed=("mesh", "depth", "mesh+depth")),
    Parameter("depth_occluder.step", INTEGER, 2,
              "Every n-th pixel of the depth image is a corner of the surface that it shows.", "px", 1, 16),
    Parameter("depth_occluder.max_jump", DOUBLE, 0.05,
              "Where depths of neighbouring corners differ by more than this share of the smaller one, the surface is "
              "cut.", low=0.001, high=1.0),
    Parameter("camera_info_policy", STRING, "auto",
              "exact pairs depth and camera_info of the same stamp, latest takes the newest camera_info; auto is exact "
              "where that stamp comes, else the newest if those around the stamp are equal bit for bit.",
              allowed=POLICIES),
    Parameter("distortion", STRING, "auto",
              "apply takes the depth image as raw: its rays come from K and D; ignore as rectified: they come from P. "
              "auto is apply where D is not zero and no word of the depth topic's last part begins with rect.",
              allowed=DISTORTION),
    Parameter("light_names", STRINGS, ("lamp",),
              "Names of the lights, each with its own group lights.<name>; [''] is none.",
              pattern=NAME, pattern_text=f"{NAME_TEXT}, not {_NO_LIGHTS[0]}"),
    CAMERA_NAMES,
    Parameter("bias.constant", DOUBLE, 0.02,
              "Shadow rays start this far from the surface. It hides depth noise and the gap between surface and "
              "mesh; too large loses contact shadows.", "m", 0.0, 1.0),
    Parameter("bias.quadratic", DOUBLE, 0.003,
              "Added to bias.constant times the square of the depth: the noise of stereo and structured light grows "
              "so.", "1/m", 0.0, 0.1),
    Parameter("bias.normal", DOUBLE, 0.6,
              "Samples are first moved by this many times the bias along the normal of their surface, where the depth "
              "image shows one or a query gives it: against speckles in grazing light.", low=0.0, high=2.0),
    Parameter("front_face_culling", BOOL, False,
              "Triangles whose front (corners counter-clockwise) faces the light cast nothing, their backs do. Only "
              "for closed meshes with outward fronts, and with a bias of nearly zero."),
    Parameter("mask.unknown_value", INTEGER, 0,
              "Mask value where nothing is known: invalid depth, or a missing camera_info, transform or light. 255 "
              "means lit and is refused.", low=0, high=254),
    Parameter("mask.publish", STRING, "listened",
              "listened makes and sends a mask only while somebody listens, always sends all of them.",
              allowed=("listened", "always")),
    Parameter("mask.dilate", INTEGER, 0,
              "Shadow in masks, depth_lit and depth_shadowed grows by so many pixels on every side; what is unknown "
              "stays so.", "px", 0, 64),
    Parameter("mask.invert", BOOL, False,
              "Masks are 255 in shadow and 0 where light reaches, and 255 - mask.unknown_value where nothing is known: "
              "for programs that leave out what is 255."),
    Parameter("markers.max_triangles", INTEGER, 100_000,
              "Most triangles in scene_markers, small parts first; a part beyond is shown as its box, which says so.",
              low=0, high=1_000_000),
    Parameter("process", STRING, "latest",
              "latest answers the newest image and drops those before it; every answers each one in order, for "
              "replays.", allowed=("latest", "every")),
    Parameter("verify_every", INTEGER, 0,
              "Every n-th frame is traced by a second pipeline too; the number of differing pixels is published. 0 is "
              "none.", low=0, high=1_000_000),
    Parameter("bounds.max_triangles", INTEGER, 1_000_000,
              "Largest number of triangles; a larger mesh is refused whole.",
              low=1, high=LIMITS["max_triangles"], read_only=_BUFFER),
    Parameter("bounds.max_rays", INTEGER, 1_310_720,
              "Largest number of pixels of a depth image (1280 x 1024); a larger image gets an unknown mask.",
              low=1, high=LIMITS["max_rays"], read_only=_BUFFER),
    Parameter("bounds.max_lights", INTEGER, 16,
              "Largest number of lights.", low=1, high=LIMITS["max_lights"], read_only=_BUFFER),
    Parameter("bounds.queue_capacity", INTEGER, 1_048_576,
              "Sample and triangle pairs that wait for the exact test on a GPU; fewer cost time, never an answer.",
              low=1, high=LIMITS["queue_capacity"], read_only=_BUFFER),
    Parameter("bounds.grid_entries", INTEGER, 4_194_304,
              "Entries of triangles in tiles (light_grid) or cells (of grids and trees); fewer cost time, "
              "never an answer.",
              low=1, high=LIMITS["grid_entries"], read_only=_BUFFER),
    Parameter("dose.parts", STRINGS, ("",),
              "Parts whose surface is watched for what it receives from lights with a strength: mesh, cloud, "
              "grid_map, markers/<ns>/<id>, files/<n>; [''] is none."),
    Parameter("dose.target", DOUBLE, 280.0,
              "Dose that is wanted; 10 J/m2 are 1 mJ/cm2.", "J/m2", 1e-6, 1e12),
    Parameter("dose.goal", DOUBLE, 0.95,
              "Share of the area at which dose/done says so.", low=0.0, high=1.0),
    Parameter("dose.max_edge", DOUBLE, 0.1,
              "Longest edge of the triangles that a part is cut into; another one begins again.", "m", 1e-4, 1e3),
    Parameter("dose.side", STRING, "front",
              "Which side of a part is watched, the front being that from which corners are seen counter-clockwise; "
              "another one begins again.", allowed=SIDES),
    Parameter("dose.folder", STRING, "",
              "Where dose/save writes a file for each part, and dose/load reads them."),
    Parameter("grid_map.layer", STRING, "elevation",
              "Layer of the topic grid_map that holds the heights of the ground; another one is looked for in the last "
              "map at once.", pattern=_LAYER, pattern_text="a name of 1 to 200 characters"),
    Parameter("grid_map.height_above", DOUBLE, 0.05,
              "shadow_grid and sun_map tell what reaches points so far above the ground: a wheel, a solar panel.",
              "m", 0.001, 100.0),
    Parameter("grid_map.dark_value", INTEGER, 100,
              "Value of shadow_grid where no light reaches; 100 is an obstacle to Nav2, less a cost.",
              low=1, high=100),
    Parameter("grid_map.period", DOUBLE, 1.0,
              "Least time between two messages on shadow_grid.", "s", 0.25, 3600.0),
    Parameter("sun_map.hours", DOUBLE, 24.0,
              "How far ahead sun_map counts hours of sun, from the time of its map on.", "h", 0.25, 744.0),
    Parameter("sun_map.step", DOUBLE, 15.0,
              "Time between two places of the sun in that sum, each in the middle of its step.", "min", 1.0, 240.0),
    Parameter("sun_map.period", DOUBLE, 60.0,
              "Least time between the beginnings of two messages on sun_map.", "s", 0.25, 86_400.0),
    Parameter("diagnostics_period", DOUBLE, 1.0,
              "Time between two messages on /diagnostics, on a steady clock.", "s", 0.02, 1.0),
)  # fmt: skip

_BY_NAME = {row.name: row for row in PARAMETERS}
_MEANT = {"cameras": "camera_names"}  # a list beside cameras.<name>.* would break `ros2 param dump`, as with lights
_GROUPS = {"lights": LIGHT_PARAMETERS, "cameras": CAMERA_PARAMETERS}
_BY_KEY = {group: {row.name: row for row in rows} for group, rows in _GROUPS.items()}


def row_of(name: str) -> Parameter | None:
    """The row of a full parameter name such as ``bias.constant`` or ``lights.lamp.range``; None if there is none."""
    group, _, rest = name.partition(".")
    if group in _BY_KEY:
        return _BY_KEY[group].get(rest.partition(".")[2])
    return _BY_NAME.get(name)


def light_names(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The names in the parameter ``light_names``; a lone empty string, the ROS way to write an empty list, is none.

    Raises:
        ParameterError: not a list of valid, different names.
    """
    row = _BY_NAME["light_names"]
    return convert_names("light_names", row, values.get("light_names", row.default), _NO_LIGHTS)


def names_for(lights: Iterable[str], cameras: Iterable[str] = ()) -> list[str]:
    """Full names of all parameters with these lights and cameras, in the order of the table."""
    return (
        [row.name for row in PARAMETERS]
        + [f"cameras.{camera}.{row.name}" for camera in cameras for row in CAMERA_PARAMETERS]
        + [f"lights.{light}.{row.name}" for light in lights for row in LIGHT_PARAMETERS]
    )


def names_in(values: Mapping[str, Any]) -> list[str]:
    """Full names of all parameters with the lights and cameras that values name. Raises ParameterError."""
    return names_for(light_names(values), camera_names(values))


def default_of(name: str) -> Any:
    """Default value of a full parameter name."""
    row = row_of(name)
    if row is None:
        raise ParameterError(f"{name}: no such parameter")
    return row.default


def settings_from(values: Mapping[str, Any]) -> Settings:
    """Check all values together and make the settings.

    Args:
        values: full parameter name -> value; what is missing has its default, what is unknown is ignored.

    Raises:
        ParameterError: the first fault found, in the order of the table.
    """
    checked = {row.name: convert(row.name, row, values.get(row.name, row.default)) for row in PARAMETERS}
    names = light_names(values)
    if len(names) > checked["bounds.max_lights"]:
        raise ParameterError(
            f"light_names: expected at most bounds.max_lights = {checked['bounds.max_lights']} names, got {len(names)}"
        )
    variants = available_pipelines()[checked["pipeline"]]
    if checked["variant"] and checked["variant"] not in variants:
        raise ParameterError(
            f"variant: expected one of {', '.join(variants)} for pipeline {checked['pipeline']}, or '' for its "
            f"default, got {checked['variant']!r}"
        )
    check_rotation("camera_pose", checked["camera_pose"])
    cameras = cameras_from(values, checked)
    lights = tuple(light_from(name, values) for name in names)
    try:
        Bounds(**{name: checked[f"bounds.{name}"] for name in LIMITS if f"bounds.{name}" in checked})
    except ValueError as error:  # of two that do not fit together
        raise ParameterError(str(error)) from error
    del checked["light_names"], checked["camera_names"]  # lights and cameras have them
    for name in ("mesh.files", "mesh.cast_no_shadows", "dose.parts"):
        checked[name] = tuple(item for item in checked[name] if item)
    if len(set(checked["dose.parts"])) != len(checked["dose.parts"]):  # twice the dose
        raise ParameterError(f"dose.parts: expected different names, got {list(checked['dose.parts'])}")
    fields = {_FIELDS.get(name, name.replace(".", "_")): value for name, value in checked.items()}
    return Settings(**{**fields, "lights": lights, "cameras": cameras})


_FIELDS = {"mask.unknown_value": "unknown_value"} | {
    row.name: row.name[7:] for row in PARAMETERS if row.name.startswith("bounds.")
}


def problems_in(values: Mapping[str, Any]) -> list[str]:
    """Every fault in the values, one sentence each; empty if there is none. At the start all are wanted at once."""
    good: dict[str, Any] = {}
    problems = []
    for name, value in values.items():
        row = row_of(name)
        if row is None:
            continue
        try:
            good[name] = convert(name, row, value)
        except ParameterError as error:
            problems.append(str(error))
    try:
        settings_from(good)
    except ParameterError as error:
        problems.append(str(error))
    return problems


def unknown_names(
    names: Iterable[str], known: Sequence[str], lights: Sequence[str], cameras: Sequence[str] = ()
) -> list[str]:
    """Warnings for names that are not among the known ones, each with the nearest known name.

    Args:
        names: names that were given.
        known: names of all declared parameters.
        lights, cameras: names of the lights and of the cameras.
    """
    lists = {"lights": ("light_names", lights), "cameras": ("camera_names", cameras)}
    warnings = []
    for name in names:
        if name in known:
            continue
        parts = name.split(".", 2)
        if row_of(name) is not None and parts[0] in lists:
            parameter, there = lists[parts[0]]
            if parts[1] not in there:
                warnings.append(
                    f"{name} has no effect: {parts[1]!r} is not in {parameter} {list(there)}; add it there, or correct "
                    "the name"
                )
                continue
        near = [_MEANT[name]] if name in _MEANT else difflib.get_close_matches(name, known, 1, 0.5)
        hint = f"did you mean {near[0]}?" if near else "see the parameter table in docs/node.md"
        warnings.append(f"{name} has no effect: there is no such parameter; {hint}")
    return warnings


def markdown_table() -> str:
    """The table as Markdown, with a final line feed."""
    lines = ["| Parameter | Type | Default | Allowed | Meaning |", "|---|---|---|---|---|"]
    rows = [(row.name, row) for row in PARAMETERS]
    rows += [(f"{group}.<name>.{row.name}", row) for group in ("cameras", "lights") for row in _GROUPS[group]]
    for name, row in rows:
        note = f" Read-only: {row.read_only}." if row.read_only else ""
        cells = (f"`{name}`", row.type, f"`{_yaml(row.default)}`", row.constraint, row.description + note)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value or '""'
    if isinstance(value, tuple):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    return repr(value)
