# SPDX-License-Identifier: Apache-2.0
"""Names and parameters as ROS would resolve them for a node that is not there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("yaml")

from shadow_tracer.apps.bag.names import Names, parameters_of


def test_topics() -> None:
    names = Names("/robot/arm/shade", ["mesh:=/room", "~/mask:=dark", "/tf:=tf", "query:=~/ask"])
    assert names.topic("depth/image_rect") == "/robot/arm/depth/image_rect"
    assert names.topic("~/mask/lamp") == "/robot/arm/shade/mask/lamp"
    assert names.topic("mesh") == names.topic("/robot/arm/mesh") == "/room"
    assert names.topic("~/mask") == "/robot/arm/dark"
    assert (names.topic("/tf"), names.topic("/tf_static")) == ("/robot/arm/tf", "/tf_static")
    assert names.topic("query") == "/robot/arm/shade/ask"
    assert Names().topic("mesh") == "/mesh" and Names().topic("~/mask") == "/shadow_tracer/mask"


@pytest.mark.parametrize("rule", ["mesh", "mesh:=", ":=mesh", "me sh:=a", "mesh:=a//b", "mesh=a", "1:=a"])
def test_bad_remaps(rule: str) -> None:
    with pytest.raises(ValueError, match="--remap: expected from:=to"):
        Names("/shade", [rule])


@pytest.mark.parametrize("node", ["shade", "", "/", "/a//b", "/1", "/a b"])
def test_bad_nodes(node: str) -> None:
    with pytest.raises(ValueError, match="--node: expected a full name"):
        Names(node)


_FILE = """
/robot/shade:
  ros__parameters: {a: exact}
/**:
  ros__parameters:
    a: all
    b: all
    group: {inner: {c: all}, d: 1}
robot:
  "*":
    ros__parameters: {b: one, group.d: 2}
/*:
  ros__parameters: {b: top}
other:
  ros__parameters: {a: other, e: other}
/**/shade:
  ros__parameters: {f: any}
"""


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        ("/robot/shade", {"a": "exact", "b": "one", "group.inner.c": "all", "group.d": 2, "f": "any"}),
        ("/other", {"a": "other", "b": "top", "group.inner.c": "all", "group.d": 1, "e": "other"}),
        ("/x/y/shade", {"a": "all", "b": "all", "group.inner.c": "all", "group.d": 1, "f": "any"}),
    ],
)
def test_which_parameters_are_meant(node: str, expected: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(_FILE)
    assert parameters_of(node, [file], []) == expected


def test_later_files_and_settings_count_more(tmp_path: Path) -> None:
    files = [tmp_path / "a.yaml", tmp_path / "b.yaml"]
    files[0].write_text("/shade: {ros__parameters: {a: 1, b: 1, c: 1}}")
    files[1].write_text("/**: {ros__parameters: {b: 2, c: 2}}")
    assert parameters_of("/shade", files, ["c:=3", "d.e:={f: 4}"]) == {"a": 1, "b": 2, "c": 3, "d.e.f": 4}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1), ("-3", -3), ("010", 10), ("1.5", 1.5), ("1e-3", 1e-3), ("2.", 2.0), (".5", 0.5), ("true", True),
        ("[1, 2.5, x]", [1, 2.5, "x"]), ("''", ""), ("12:30", "12:30"), ("2026-06-21", "2026-06-21"),
        ("2026-06-21T12:00:00Z", "2026-06-21T12:00:00Z"), ("cuda:0", "cuda:0"), ("'1'", "1"), ("package://a/b.stl",
        "package://a/b.stl"),
    ],
)  # fmt: skip
def test_values_have_the_types_of_ros(text: str, value: Any) -> None:
    found = parameters_of("/shade", [], [f"x:={text}"])["x"]
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "not YAML"),
        ("just text", "expected names of nodes under 'the root', got 'just text'"),
        ("/shade: {a: 1}", "expected names of nodes under '/shade/a', got 1"),
        ("/shade: {ros__parameters: 3}", "expected parameters under '/shade', got 3"),
        ("{}", "has no ros__parameters"),
        ("", "expected names of nodes"),
        ("a: !!python/object/apply:os.system [ls]", "not YAML"),
    ],
)
def test_bad_files(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        parameters_of("/shade", [file], [])
    assert str(caught.value).startswith("--params-file")


def test_every_file_of_the_package_can_be_read() -> None:
    config = Path(__file__).resolve().parents[3] / "config"
    files = [path for path in config.glob("*.yaml") if "ros__parameters" in path.read_text()]
    assert files
    for file in files:
        assert parameters_of("/shadow_tracer", [file], [])
