# SPDX-License-Identifier: Apache-2.0
"""The node's parameters for a demo, and their file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from shadow_tracer.apps.demo import publisher
from shadow_tracer.apps.demo.sequence import Sequence

UNKNOWN_VALUE = 100


def parameters(sequence: Sequence, pipeline: str, variant: str, device: str) -> dict[str, Any]:
    """The node's parameters for a sequence: full name -> value."""
    values: dict[str, Any] = {
        "pipeline": pipeline,
        "variant": variant,
        "device": device,
        "fixed_frame": publisher.WORLD_FRAME,
        "pose_source": "topic",
        "bias.constant": sequence.bias[0],
        "bias.quadratic": sequence.bias[1],
        "bias.normal": 0.0,  # the bias of a sequence is made for rays alone
        "mask.unknown_value": UNKNOWN_VALUE,
        "light_names": [light.name for light in sequence.lights],
    }
    for light in sequence.lights:
        values |= {f"lights.{light.name}.{key}": value for key, value in light.parameters().items()}
    # an image of more than half a megabyte gets lost if it is sent best effort with the stock settings
    for topic in (publisher.DEPTH_TOPIC, publisher.INFO_TOPIC):
        values[f"qos_overrides./{topic}.subscription.reliability"] = "reliable"
    for light in sequence.lights:
        values[f"qos_overrides.{publisher.MASK_TOPIC}/{light.name}.publisher.depth"] = publisher.KEPT
    return values


def yaml(values: Mapping[str, Any], node: str = "/shadow_tracer") -> str:
    """Text of a parameter file for one node."""
    lines = [f"{node}:", "  ros__parameters:"]
    lines += [f"    {json.dumps(name)}: {_text(value)}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def _text(value: Any) -> str:
    if isinstance(value, float):
        return np.format_float_positional(value, trim="0")  # every bit, and no exponent
    if isinstance(value, list):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    return json.dumps(value)
