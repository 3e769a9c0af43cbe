# SPDX-License-Identifier: Apache-2.0
"""Names as ROS resolves them: topics of a node that is not there, and which parameters of a file are meant for it."""

from __future__ import annotations

import copy
import importlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shadow_tracer.ros.settings import CameraSettings

_OF_A_CAMERA = ("camera_info", "irradiance", "light_bits", "mask", "overlay", "timing", "visibility")
_NODE = re.compile(r"(/[A-Za-z_]\w*)+")
_TOPIC = re.compile(r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*")


class Names:
    """Topics of one node.

    Args:
        node: its full name, such as ``/shadow_tracer``.
        remaps: ``from:=to``, each a topic of the node, relative, absolute or starting with ``~/``.

    Raises:
        ValueError: a name that cannot be one.
    """

    def __init__(self, node: str = "/shadow_tracer", remaps: Sequence[str] = ()) -> None:
        if not _NODE.fullmatch(node):
            raise ValueError(f"--node: expected a full name such as /robot/shadow_tracer, got {node!r}")
        self.node = node
        self._namespace = node.rpartition("/")[0]
        self._remaps: dict[str, str] = {}
        self._camera = ""
        self._inputs: dict[str, str] = {}
        for rule in remaps:
            before, found, after = rule.partition(":=")
            if not found or not _TOPIC.fullmatch(before) or not _TOPIC.fullmatch(after):
                raise ValueError(f"--remap: expected from:=to with two topics, got {rule!r}")
            self._remaps[self._expand(before)] = self._expand(after)

    def of(self, camera: CameraSettings) -> Names:
        """The names where the node has several cameras, for one of them."""
        names = copy.copy(self)
        names._camera = camera.name
        names._inputs = {
            "depth/image_rect": camera.depth_topic, "depth/camera_info": camera.info_topic,
            "camera_pose": camera.pose_topic,
        }  # fmt: skip
        return names

    def topic(self, name: str) -> str:
        """Full name of a topic, such as ``depth/image_rect`` or ``~/mask``, after remapping."""
        full = self._expand(self.before(name))
        return self._remaps.get(full, full)

    def before(self, name: str) -> str:
        """What the topic is called that a remapping of this one names: that of the camera."""
        if self._camera and name.startswith("~/") and name[2:].partition("/")[0] in _OF_A_CAMERA:
            return f"~/{self._camera}/{name[2:]}"
        return self._inputs.get(name, name)

    def _expand(self, name: str) -> str:
        if name.startswith("/"):
            return name
        return f"{self.node}{name[1:]}" if name.startswith("~/") else f"{self._namespace}/{name}"


def parameters_of(node: str, paths: Sequence[Path], settings: Sequence[str]) -> dict[str, Any]:
    """Parameters for a node, as ``--params-file`` and ``-p`` give them to one.

    Args:
        node: its full name.
        paths: parameter files; of several the last counts, within one what names the node before what has wildcards.
        settings: ``name:=value`` in YAML; these count most.

    Returns:
        Full parameter name -> value, nested groups joined by dots.

    Raises:
        ValueError: a file cannot be read or is no parameter file, or a setting is malformed.
    """
    values: dict[str, Any] = {}
    for path in paths:
        values |= _from_file(node, path)
    for setting in settings:
        name, found, text = setting.partition(":=")
        if not name or not found:
            raise ValueError(f"--param: expected name:=value, got {setting!r}")
        value = _load(text, f"--param {name}")
        values |= _flat(value, name) if isinstance(value, Mapping) else {name: value}
    return values


def _from_file(node: str, path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"--params-file: {path} cannot be read: {error}") from error
    nodes = _sections(_load(text, f"--params-file {path}"), "", path)
    if not nodes:
        raise ValueError(f"--params-file: {path} has no ros__parameters; see the files in config/")
    exact, matching = [], []
    for pattern, values in nodes:
        if "*" not in pattern:
            exact += [values] if pattern == node else []
        elif _matches(pattern, node):
            matching.append(values)
    return {name: value for values in [*matching, *exact] for name, value in values.items()}


def _sections(tree: Any, above: str, path: Path) -> list[tuple[str, dict[str, Any]]]:
    if not isinstance(tree, Mapping):
        raise ValueError(f"--params-file: {path}: expected names of nodes under {above or 'the root'!r}, got {tree!r}")
    found = []
    for key, value in tree.items():
        name = f"{above}/{str(key).strip('/')}"
        if key == "ros__parameters":
            if not isinstance(value, Mapping):
                raise ValueError(f"--params-file: {path}: expected parameters under {above!r}, got {value!r}")
            found.append((above, _flat(value)))
        else:
            found += _sections(value, name, path)
    return found


def _flat(tree: Mapping[Any, Any], above: str = "") -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{above}.{key}" if above else str(key)
        values |= _flat(value, name) if isinstance(value, Mapping) else {name: value}
    return values


def _matches(pattern: str, node: str) -> bool:
    parts = {"**": r"(?:/\w+)*", "*": r"/\w+"}
    expression = "".join(parts.get(part, "/" + re.escape(part)) for part in pattern.strip("/").split("/"))
    return re.fullmatch(expression, node) is not None


def _load(text: str, what: str) -> Any:
    """YAML with the plain types of ROS: 1e-3 is a number, and a date stays text."""
    yaml: Any = importlib.import_module("yaml")
    loader: Any = type("Loader", (yaml.SafeLoader,), {})

    plain = ("tag:yaml.org,2002:bool", "tag:yaml.org,2002:null", "tag:yaml.org,2002:merge")
    loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in rules if tag in plain]
        for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    digits = list("-+.0123456789")
    whole, real = re.compile(r"[-+]?\d+"), re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|nan)")
    for tag, pattern in (("int", whole), ("float", real)):
        loader.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", re.compile(f"(?:{pattern.pattern})$"), digits)
    loader.add_constructor("tag:yaml.org,2002:int", lambda made, node: int(made.construct_scalar(node)))
    try:
        return yaml.load(text, loader)  # a subclass of SafeLoader
    except yaml.YAMLError as error:
        raise ValueError(f"{what}: not YAML: {error}") from error
