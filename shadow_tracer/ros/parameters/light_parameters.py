# SPDX-License-Identifier: Apache-2.0
"""The parameters of a light, ``lights.<name>.*``, and what of them must fit together. No ROS here."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from shadow_tracer import IntensityTable, Strength
from shadow_tracer.ros.parameters.parameter_rows import (
    BOOL,
    DOUBLE,
    DOUBLES,
    STRING,
    STRINGS,
    Parameter,
    ParameterError,
    convert,
)
from shadow_tracer.ros.parameters.photometry import table_of
from shadow_tracer.ros.settings import LIGHT_TYPES, LightSettings, SunSettings
from shadow_tracer.scene.intensity_table import LARGEST_EFFICACY, UNITS
from shadow_tracer.scene.strength import MODELS, QUANTITIES
from shadow_tracer.scene.sun import parse_time

FRAME = re.compile(r"(?!/)\S+|")
FRAME_TEXT = 'a tf frame without leading "/", or ""'
_LEAST_RADIUS = 1e-6

LIGHT_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("type", STRING, "point",
              "Kind of light. The sun stands where date, time and place put it, if the axes of its frame are east, "
              "north, up; sphere, disc, rectangle and tube cast soft shadows.", allowed=LIGHT_TYPES),
    Parameter("enabled", BOOL, True,
              "Whether it shines; the mask of a light that does not is not published."),
    Parameter("frame", STRING, "",
              "Frame of position, direction and axis; empty is fixed_frame. The optical frame of the depth image needs "
              "no tf.", pattern=FRAME, pattern_text=FRAME_TEXT),
    Parameter("position", DOUBLES, (0.5, -0.5, 0.0),
              "Where a light is, of one with a size its middle. The default is to the right of and above the camera, "
              "if fixed_frame is left empty.", "m", length=3),
    Parameter("direction", DOUBLES, (0.0, 0.0, 1.0),
              "The way light travels, of a spot or directional light, and from the middle of a disc or rectangle; any "
              "length but zero. The default is the way the camera looks, if fixed_frame is left empty.", length=3),
    Parameter("axis", DOUBLES, (1.0, 0.0, 0.0),
              "Along a tube, and along the first side of a rectangle, of which the part across direction counts; any "
              "length but zero.", length=3),
    Parameter("outer_angle", DOUBLE, 0.5,
              "Half angle of a spot light's cone; what lies outside is not reached.", "rad", 0.001, math.pi),
    Parameter("range", DOUBLE, 0.0,
              "How far a light that has a position reaches; 0 is without limit.", "m", 0.0, 1e9),
    Parameter("radius", DOUBLE, 0.1,
              "Radius of a sphere, disc or tube light; 0 is a tube that is a line.", "m", 0.0, 1e6),
    Parameter("length", DOUBLE, 1.0,
              "Length of a tube light.", "m", 1e-6, 1e6),
    Parameter("size", DOUBLES, (0.5, 0.5),
              "Sides of a rectangle light, the first along axis.", "m", length=2),
    Parameter("two_sided", BOOL, False,
              "Whether a disc or rectangle shines against direction, too. Else nothing of it is seen from behind."),
    Parameter("angular_diameter", DOUBLE, 0.0,
              "Of the disc of a sun or directional light, which then casts soft shadows; the sun's is 0.0093. 0 is "
              "without size.", "rad", 0.0, math.pi / 2),
    Parameter("ignore", STRINGS, ("",),
              "Parts that cast no shadow in this light, such as its housing: mesh, cloud, markers/<ns>/<id>, files/<n> "
              "(counted from 0) or depth; a name stands for all that begin with it and a slash. [''] is none."),
    Parameter("power", DOUBLE, 0.0,
              "Radiant flux of a light that has a position, of the wavelengths that matter; 0 is unknown. Of power, "
              "intensity, exitance and irradiance one may be set; without one there is no irradiance.",
              "W", 0.0, 1e9),
    Parameter("intensity", DOUBLE, 0.0,
              "Radiant intensity of a light that has a position, where it is largest, from far away; 0 is unknown.",
              "W/sr", 0.0, 1e9),
    Parameter("exitance", DOUBLE, 0.0,
              "Radiant flux of each square metre of a sphere, disc, rectangle or tube; 0 is unknown.",
              "W/m2", 0.0, 1e9),
    Parameter("irradiance", DOUBLE, 0.0,
              "Of a directional light or the sun, on a plane at right angles to it; 0 is unknown.", "W/m2", 0.0, 1e9),
    Parameter("model", STRING, "",
              "How intensity falls with the angle: alike everywhere, or with the cosine. Empty: lambert of lights with "
              "a size, isotropic of point and spot.", allowed=("", *MODELS)),
    Parameter("ies.file", STRING, "",
              "IES LM-63 file of type C, in the place of model: a path, file:// or package://<package>/...; vertical "
              "angles count from direction, horizontal ones from the part of axis across it. Without power, intensity "
              "or exitance it says these, too. Empty is none. Needs photompy (extra photometry)."),
    Parameter("ies.unit", STRING, "",
              "What the numbers of the file are, whatever it calls them; set it before the file, or together.",
              allowed=("", *UNITS)),
    Parameter("ies.lumens_per_watt", DOUBLE, 0.0,
              "Luminous flux of a watt of the lamp's radiation, which its spectrum says; needed for cd and for it "
              "alone, 0 else. Of ultraviolet and infrared there is none.", "lm/W", 0.0, LARGEST_EFFICACY),
    Parameter("output", DOUBLE, 1.0,
              "Factor of power, intensity, exitance or irradiance, for age, dirt, warming up and dimming.",
              low=0.0, high=1.0),
    Parameter("sun.latitude", DOUBLE, 0.0,
              "Where the sun is seen from, north positive.", "deg", -90.0, 90.0),
    Parameter("sun.longitude", DOUBLE, 0.0,
              "Where the sun is seen from, east positive.", "deg", -180.0, 180.0),
    Parameter("sun.time", STRING, "",
              "When, as ISO 8601 (2026-06-21T12:00:00Z, without a zone UTC); empty is the stamp of the image."),
)  # fmt: skip


def light_from(name: str, values: Mapping[str, Any]) -> LightSettings:
    """The light of a name.

    Raises:
        ParameterError: the first fault found.
    """
    keys = {}
    for row in LIGHT_PARAMETERS:
        full = f"lights.{name}.{row.name}"
        keys[row.name] = convert(full, row, values.get(full, row.default))
    text = keys.pop("sun.time")
    try:
        time = parse_time(text) if text else None
    except ValueError as error:
        raise ParameterError(f"lights.{name}.sun.time: {error}") from error
    sun = SunSettings(keys.pop("sun.latitude"), keys.pop("sun.longitude"), time)
    keys["ignore"] = tuple(part for part in keys["ignore"] if part)
    light = LightSettings(name=name, sun=sun, strength=_strength_from(name, keys), **keys)
    _check(light)
    try:
        light.light(np.eye(4))
    except ValueError as error:  # a strength that this type cannot have
        field, _, rest = str(error).removeprefix("strength.").partition(":")
        if field == "model" and values.get(f"lights.{name}.ies.file"):
            field = "ies.file"
        raise ParameterError(f"lights.{name}.{field}:{rest}") from error
    return light


def _strength_from(name: str, keys: dict[str, Any]) -> Strength | None:
    """Take what makes a strength out of the values by key."""
    given = {quantity: value for quantity in QUANTITIES if (value := keys.pop(quantity)) > 0.0}
    model, output = keys.pop("model") or None, keys.pop("output")
    file, unit, lumens = (keys.pop(f"ies.{key}") for key in ("file", "unit", "lumens_per_watt"))
    if len(given) > 1:
        raise ParameterError(f"lights.{name}.{list(given)[1]}: expected 0 beside {list(given)[0]}, got both")
    if not file:
        return Strength(**given, model=model, output=output) if given else None
    if model is not None:
        raise ParameterError(f"lights.{name}.model: expected '' beside ies.file, got {model!r}")
    return Strength(**given, model=table_of(name, file, unit, lumens), output=output)


def _check(light: LightSettings) -> None:
    for key, vector in (("direction", light.direction), ("axis", light.axis)):
        if not 1e-6 <= math.sqrt(sum(value * value for value in vector)) <= 1e6:
            raise ParameterError(f"lights.{light.name}.{key}: expected a length from 1e-6 to 1e6, got {list(vector)}")
    if not all(_LEAST_RADIUS <= side <= 1e6 for side in light.size):
        raise ParameterError(
            f"lights.{light.name}.size: expected two sides from {_LEAST_RADIUS:g} to 1e+06 m, got {list(light.size)}"
        )
    if light.type in ("sphere", "disc") and light.radius < _LEAST_RADIUS:
        raise ParameterError(
            f"lights.{light.name}.radius: expected at least {_LEAST_RADIUS:g} m for type {light.type}, got "
            f"{light.radius:g}"
        )
    table = light.strength is not None and isinstance(light.strength.model, IntensityTable)
    if light.type == "rectangle" or table:
        way, axis = (np.asarray(vector) / np.linalg.norm(vector) for vector in (light.direction, light.axis))
        if np.linalg.norm(np.cross(way, axis)) < 1e-3:
            raise ParameterError(
                f"lights.{light.name}.axis: expected another line than direction {list(light.direction)} for "
                f"{'ies.file' if table else 'type rectangle'}, got {list(light.axis)}"
            )
