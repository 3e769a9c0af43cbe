# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the node, declared once: type, default, unit, range and meaning. No ROS here.

``python -m shadow_tracer.ros.parameters`` prints the table as Markdown, as it stands in the README.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shadow_tracer import available_pipelines
from shadow_tracer.ros.settings import LIGHT_TYPES, LightSettings, Settings

BOOL, INTEGER, DOUBLE, STRING = "bool", "integer", "double", "string"
STRINGS, DOUBLES = "string array", "double array"

_BUFFER = "device buffers of this size are allocated once, at start; restart the node to change it"
_DEVICE = "buffers and kernels live on one device from the start; restart the node to change it"
_FRAME = re.compile(r"(?!/)\S+|")
_DEVICE_NAME = re.compile(r"auto|cpu|cuda:\d+")
_LIGHT_NAME = re.compile(r"[A-Za-z](?:_?[A-Za-z0-9])*")


class ParameterError(ValueError):
    """A parameter has a value it cannot have. The message starts with its name, then what is allowed and what came."""


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Attributes:
        name: full name, or the key within ``lights.<name>``.
        type: one of the type words above.
        default: value if nothing is set.
        description: meaning, one or two sentences.
        unit: unit of the value, "" if it has none.
        low, high: inclusive range of a number.
        allowed: the words a string may be; empty if it is free.
        length: number of values of a double array.
        pattern, pattern_text: what a string must look like, and that in words.
        read_only: why it cannot change at run time; "" if it can.
    """

    name: str
    type: str
    default: Any
    description: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    allowed: tuple[str, ...] = ()
    length: int = 0
    pattern: re.Pattern[str] | None = None
    pattern_text: str = ""
    read_only: str = ""

    @property
    def constraint(self) -> str:
        """The allowed values in words, unit included; "" if every value of the type is allowed."""
        unit = f" {self.unit}" if self.unit else ""
        if self.allowed:
            return ", ".join(word or '""' for word in self.allowed)
        if self.low is not None:
            return f"{_number(self.low)} to {_number(self.high)}{unit}"
        if self.length:
            return f"{self.length} numbers{unit}"
        return self.pattern_text


def _number(value: Any) -> str:
    return "pi" if value == math.pi else f"{value:.12g}"


def _pipelines() -> tuple[str, ...]:
    return tuple(available_pipelines())


def _variants() -> tuple[str, ...]:
    return ("", *dict.fromkeys(variant for variants in available_pipelines().values() for variant in variants))


_FRAME_TEXT = 'a tf frame without leading "/", or ""'

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("pipeline", STRING, "light_grid",
              "How shadows are found. All pipelines give the same masks.", allowed=_pipelines()),
    Parameter("variant", STRING, "",
              "Variant of the pipeline; empty is the pipeline's default.", allowed=_variants()),
    Parameter("device", STRING, "auto",
              "Where kernels run; auto takes the first CUDA device, or the CPU if there is none.",
              pattern=_DEVICE_NAME, pattern_text="auto, cpu, cuda:N", read_only=_DEVICE),
    Parameter("fixed_frame", STRING, "",
              "World frame of meshes and lights. Empty: with pose_source tf the world is the optical frame of the "
              "depth image and needs no tf; with the other sources it is the frame their poses are given in.",
              pattern=_FRAME, pattern_text=_FRAME_TEXT),
    Parameter("pose_source", STRING, "tf",
              "Where the pose of the camera's optical frame in fixed_frame comes from: tf (at the stamp of the "
              "image), the topic camera_pose, or the parameter camera_pose.", allowed=("tf", "topic", "parameter")),
    Parameter("camera_pose", DOUBLES, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
              "Pose of the optical frame, x y z [m] qx qy qz qw, used when pose_source is parameter.", length=7),
    Parameter("tf_timeout", DOUBLE, 0.2,
              "How long a frame waits for its transforms, camera pose and camera_info before its mask says unknown; "
              "a camera_pose farther than this from the stamp of the image is not used.", "s", 0.0, 10.0),
    Parameter("mesh.frame", STRING, "",
              "Frame of the topic mesh, which has no header; empty is fixed_frame.",
              pattern=_FRAME, pattern_text=_FRAME_TEXT),
    Parameter("mesh.max_age", DOUBLE, 0.0,
              "A mesh received longer ago than this is stale and the mask says unknown; 0 never.", "s", 0.0, 1e6),
    Parameter("camera_info_policy", STRING, "exact",
              "exact pairs depth and camera_info of the same stamp, latest takes the newest camera_info.",
              allowed=("exact", "latest")),
    Parameter("lights", STRINGS, ("lamp",),
              "Names of the lights, each with its own group lights.<name>; [''] is none.",
              pattern=_LIGHT_NAME, pattern_text="letters, digits and single underscores, a letter first"),
    Parameter("bias.constant", DOUBLE, 0.02,
              "Shadow rays start this far from the surface. It hides depth noise and the gap between surface and "
              "mesh; too large loses contact shadows.", "m", 0.0, 10.0),
    Parameter("bias.quadratic", DOUBLE, 0.003,
              "Added to bias.constant times the square of the depth: the noise of stereo and structured light grows "
              "so.", "1/m", 0.0, 1.0),
    Parameter("front_face_culling", BOOL, False,
              "Triangles whose front (corners counter-clockwise) faces the light cast nothing, their backs do. Only "
              "for closed meshes with outward fronts, and with a bias of nearly zero."),
    Parameter("mask.unknown_value", INTEGER, 0,
              "Mask value where nothing is known: invalid depth, or a missing camera_info, transform or light. 255 "
              "means lit and is refused.", low=0, high=254),
    Parameter("bounds.max_triangles", INTEGER, 1_000_000,
              "Largest number of triangles; a larger mesh is refused whole.",
              low=1, high=2**31 // 9, read_only=_BUFFER),
    Parameter("bounds.max_rays", INTEGER, 1_310_720,
              "Largest number of pixels of a depth image (1280 x 1024); a larger image gets an unknown mask.",
              low=1, high=2**31 // 4, read_only=_BUFFER),
    Parameter("bounds.max_lights", INTEGER, 16,
              "Largest number of lights.", low=1, high=64, read_only=_BUFFER),
    Parameter("bounds.queue_capacity", INTEGER, 1_048_576,
              "Sample and triangle pairs that wait for the exact test; fewer cost passes, never an answer.",
              low=1, high=2**30, read_only=_BUFFER),
    Parameter("bounds.grid_entries", INTEGER, 4_194_304,
              "Entries of triangles in tiles (pipeline light_grid); fewer cost passes, never an answer.",
              low=1, high=2**31 - 1, read_only=_BUFFER),
    Parameter("diagnostics_period", DOUBLE, 1.0,
              "Time between two messages on /diagnostics, on a steady clock.", "s", 0.1, 1.0),
)  # fmt: skip

LIGHT_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("type", STRING, "point",
              "Kind of light.", allowed=LIGHT_TYPES),
    Parameter("enabled", BOOL, True,
              "Whether it shines; the mask of a light that does not is not published."),
    Parameter("frame", STRING, "",
              "Frame of position and direction; empty is fixed_frame. The optical frame of the depth image needs no "
              "tf.", pattern=_FRAME, pattern_text=_FRAME_TEXT),
    Parameter("position", DOUBLES, (0.5, -0.5, 0.0),
              "Position of a point or spot light. The default is to the right of and above the camera, if "
              "fixed_frame is left empty.", "m", length=3),
    Parameter("direction", DOUBLES, (0.0, 0.0, 1.0),
              "The way light travels, of a spot or directional light; any length but zero. The default is the way "
              "the camera looks, if fixed_frame is left empty.", length=3),
    Parameter("outer_angle", DOUBLE, 0.5,
              "Half angle of a spot light's cone; what lies outside is not reached.", "rad", 0.001, math.pi),
    Parameter("range", DOUBLE, 0.0,
              "How far a point or spot light reaches; 0 is without limit.", "m", 0.0, 1e9),
)  # fmt: skip

_BY_NAME = {row.name: row for row in PARAMETERS}
_BY_KEY = {row.name: row for row in LIGHT_PARAMETERS}


def row_of(name: str) -> Parameter | None:
    """The row of a full parameter name such as ``bias.constant`` or ``lights.lamp.range``; None if there is none."""
    if name.startswith("lights."):
        return _BY_KEY.get(name.rpartition(".")[2]) if name.count(".") == 2 else None
    return _BY_NAME.get(name)


def light_names(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The names in the parameter ``lights``; a lone empty string, the ROS way to write an empty list, is none.

    Raises:
        ParameterError: not a list of valid, different names.
    """
    names = convert("lights", _BY_NAME["lights"], values.get("lights", _BY_NAME["lights"].default))
    if names == ("",):
        return ()
    for name in names:
        if not _LIGHT_NAME.fullmatch(name):
            raise ParameterError(f"lights: expected names of {_BY_NAME['lights'].constraint}, got {name!r}")
    if len(set(names)) != len(names):
        raise ParameterError(f"lights: expected different names, got {list(names)}")
    return names


def convert(name: str, row: Parameter, value: Any) -> Any:
    """The value in the type of its row: integers become doubles where doubles are wanted, arrays become tuples.

    Raises:
        ParameterError: wrong type, out of range, not finite, not an allowed word.
    """
    if row.type == BOOL:
        good = isinstance(value, bool)
    elif row.type == STRING:
        good = isinstance(value, str)
        if good and row.allowed:
            good = value in row.allowed
        elif good and row.pattern:
            good = row.pattern.fullmatch(value) is not None
    elif row.type == STRINGS:
        value = _sequence(value)
        good = value is not None and all(isinstance(item, str) for item in value)
    elif row.type == DOUBLES:
        value = _sequence(value)
        good = value is not None and len(value) == row.length and all(_is_number(item) for item in value)
        value = tuple(float(item) for item in value) if good else value
    else:
        good = _is_number(value) if row.type == DOUBLE else _is_integer(value)
        good = good and (row.low is None or row.high is None or row.low <= value <= row.high)
        value = float(value) if good and row.type == DOUBLE else value
    if not good:
        wanted = f"{row.type} ({row.constraint})" if row.constraint else row.type
        raise ParameterError(f"{name}: expected {wanted}, got {value!r}")
    return value


def _sequence(value: Any) -> tuple[Any, ...] | None:
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        return None
    return tuple(value)


def _is_integer(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return _is_integer(value) or (isinstance(value, (float, np.floating)) and math.isfinite(value))


def names_for(lights: Iterable[str]) -> list[str]:
    """Full names of all parameters with these lights, in the order of the table."""
    return [row.name for row in PARAMETERS] + [
        f"lights.{light}.{row.name}" for light in lights for row in LIGHT_PARAMETERS
    ]


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
            f"lights: expected at most bounds.max_lights = {checked['bounds.max_lights']} names, got {len(names)}"
        )
    variants = available_pipelines()[checked["pipeline"]]
    if checked["variant"] and checked["variant"] not in variants:
        raise ParameterError(
            f"variant: expected one of {', '.join(variants)} for pipeline {checked['pipeline']}, or '' for its "
            f"default, got {checked['variant']!r}"
        )
    length = math.sqrt(sum(value * value for value in checked["camera_pose"][3:]))
    if not 0.99 <= length <= 1.01:
        raise ParameterError(f"camera_pose: expected a unit quaternion qx qy qz qw, got one of length {length:.6g}")
    lights = tuple(_light(name, values) for name in names)
    fields = {_FIELDS.get(name, name.replace(".", "_")): value for name, value in checked.items()}
    return Settings(**{**fields, "lights": lights})


_FIELDS = {"mask.unknown_value": "unknown_value"} | {
    row.name: row.name[7:] for row in PARAMETERS if row.name.startswith("bounds.")
}


def _light(name: str, values: Mapping[str, Any]) -> LightSettings:
    keys = {}
    for row in LIGHT_PARAMETERS:
        full = f"lights.{name}.{row.name}"
        keys[row.name] = convert(full, row, values.get(full, row.default))
    light = LightSettings(name=name, **keys)
    if not 1e-6 <= math.sqrt(sum(value * value for value in light.direction)) <= 1e6:
        raise ParameterError(
            f"lights.{name}.direction: expected a length from 1e-6 to 1e6, got {list(light.direction)}"
        )
    return light


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


def unknown_names(names: Iterable[str], known: Sequence[str], lights: Sequence[str]) -> list[str]:
    """Warnings for names that are not among the known ones, each with the nearest known name.

    Args:
        names: names that were given.
        known: names of all declared parameters.
        lights: names of the lights.
    """
    warnings = []
    for name in names:
        if name in known:
            continue
        parts = name.split(".")
        if parts[0] == "lights" and len(parts) == 3 and parts[1] not in lights and parts[2] in _BY_KEY:
            warnings.append(
                f"{name} has no effect: {parts[1]!r} is not in lights {list(lights)}; add it there, or correct the name"
            )
            continue
        near = difflib.get_close_matches(name, known, 1, 0.5)
        hint = f"did you mean {near[0]}?" if near else "see the parameter table in the README"
        warnings.append(f"{name} has no effect: there is no such parameter; {hint}")
    return warnings


def markdown_table() -> str:
    """The table as Markdown, with a final line feed."""
    lines = ["| Parameter | Type | Default | Allowed | Meaning |", "|---|---|---|---|---|"]
    rows = [(row.name, row) for row in PARAMETERS] + [(f"lights.<name>.{row.name}", row) for row in LIGHT_PARAMETERS]
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


if __name__ == "__main__":
    print(markdown_table(), end="")
