# SPDX-License-Identifier: Apache-2.0
"""The files that make this tree installable agree with each other and with the sources."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import setuptools
import yaml

ROOT = Path(__file__).resolve().parents[1]
NAME = "shadow_tracer"
# Python packages whose ROS package has another name.
ROS_PACKAGE_OF = {"tf2_ros": "tf2_ros_py"}
PIP_PACKAGES = {"DracoPy", "PIL", "ephem", "mapbox_earcut", "numpy", "scipy", "trimesh", "yaml"}


@pytest.fixture(scope="module")
def manifest() -> ElementTree.Element:
    """The root element of package.xml."""
    return ElementTree.parse(ROOT / "package.xml").getroot()


@pytest.fixture(scope="module")
def setup_arguments() -> dict[str, Any]:
    """What setup.py hands to setuptools."""
    arguments: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setuptools, "setup", arguments.update)
        patch.chdir(ROOT)
        runpy.run_path("setup.py", run_name="__main__")
    return arguments


@pytest.fixture(scope="module")
def scripts(setup_arguments: dict[str, Any]) -> dict[str, str]:
    """The console scripts: name -> "module:function"."""
    entries = setup_arguments["entry_points"]["console_scripts"]
    return {name.strip(): target.strip() for name, target in (entry.split("=") for entry in entries)}


@pytest.fixture(scope="module")
def data_files(setup_arguments: dict[str, Any]) -> dict[str, list[str]]:
    """Where what is installed outside site-packages: destination -> files."""
    return dict(setup_arguments["data_files"])


def imports_of(path: Path) -> set[str]:
    """Top-level names of every absolute import in a file: those inside functions and by import_module too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module":
            names |= {str(argument.value).split(".")[0] for argument in node.args if isinstance(argument, ast.Constant)}
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add((node.module or "").split(".")[0])
    return names


def test_versions_agree(setup_arguments: dict[str, Any], manifest: ElementTree.Element) -> None:
    """setup.py, package.xml and the newest entry of the changelog name one version."""
    newest = re.search(
        r"^(\d+\.\d+\.\d+) \(\d{4}-\d{2}-\d{2}\)\n-+$", (ROOT / "CHANGELOG.rst").read_text(), re.MULTILINE
    )
    assert newest, "CHANGELOG.rst has no entry of the form '1.2.3 (2026-01-31)' with its underline"
    assert {setup_arguments["version"], manifest.findtext("version"), newest.group(1)} == {setup_arguments["version"]}


def test_citation_agrees(setup_arguments: dict[str, Any], manifest: ElementTree.Element) -> None:
    """CITATION.cff has what its format requires, and names, version, date and licence that stand elsewhere too."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0" and citation["message"] and citation["abstract"]
    assert (citation["title"], citation["license"]) == (NAME, setup_arguments["license"])
    assert citation["version"] == setup_arguments["version"]
    assert citation["authors"] == [{"name": setup_arguments["author"]}]
    assert manifest.findtext("maintainer") == setup_arguments["author"]
    assert f"{citation['version']} ({citation['date-released']})" in (ROOT / "CHANGELOG.rst").read_text()


def test_package_xml_has_what_rep_149_requires(setup_arguments: dict[str, Any], manifest: ElementTree.Element) -> None:
    """Format 3, the required tags, an e-mail address, an existing licence file, the build type."""
    assert (manifest.tag, manifest.get("format")) == ("package", "3")
    assert manifest.findtext("name") == setup_arguments["name"] == NAME
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest.findtext("version") or "")
    assert (manifest.findtext("description") or "").strip()
    maintainers = manifest.findall("maintainer")
    assert maintainers and all(
        re.fullmatch(r"[^@\s]+@[^@\s]+\.[a-z]+", person.get("email", "")) for person in maintainers
    )
    licence = manifest.find("license")
    assert licence is not None and licence.text == "Apache-2.0" and (ROOT / licence.get("file", "")).is_file()
    assert manifest.findtext("export/build_type") == "ament_python"
    depends = [element.text for element in manifest if element.tag.endswith("_depend")]
    assert len(depends) == len(set(depends)), "a dependency stands twice"


def test_package_xml_names_every_ros_package_in_use(manifest: ElementTree.Element) -> None:
    """Each ROS import of the package and of its launch files has its exec_depend, and no exec_depend is left over."""
    sources = [*(ROOT / NAME).rglob("*.py"), *(ROOT / "launch").glob("*.py")]
    third_party = (
        set[str]().union(
            *(imports_of(path) for room in ("ros", "testing") for path in (ROOT / NAME / room).rglob("*.py"))
        )
        - set(sys.stdlib_module_names)
        - {NAME}
    )
    needed = {ROS_PACKAGE_OF.get(name, name) for name in third_party - PIP_PACKAGES}
    assert "rclpy" in needed
    every_import = {ROS_PACKAGE_OF.get(name, name) for path in sources for name in imports_of(path)}
    named = {element.text for element in manifest.findall("exec_depend")}
    assert needed - named == set()
    assert {name for name in named if name and not name.startswith("python3-")} - every_import == set()


def test_console_scripts_lead_to_functions(scripts: dict[str, str]) -> None:
    """Each target module is a file here and defines the function."""
    assert "shadow_node" in scripts
    for target in scripts.values():
        module, function = target.split(":")
        path = ROOT / Path(*module.split(".")).with_suffix(".py")
        assert path.is_file(), f"{target}: no {path.name}"
        defined = {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}
        assert function in defined, f"{target}: {path.name} defines {sorted(defined)}"


def test_data_files_make_a_ros_package(data_files: dict[str, list[str]]) -> None:
    """The marker that ament looks for, the manifest, and parameter files; all of them exist."""
    assert data_files["share/ament_index/resource_index/packages"] == [f"resource/{NAME}"]
    assert data_files[f"share/{NAME}"] == ["package.xml"]
    assert data_files[f"share/{NAME}/config"], "no parameter files"
    for files in data_files.values():
        assert all((ROOT / file).is_file() for file in files)
    shipped = {file for files in data_files.values() for file in files}
    unshipped = {
        path.relative_to(ROOT).as_posix()
        for folder in ("config", "launch")
        for path in (ROOT / folder).glob("*")
        if path.is_file()
    } - shipped
    assert unshipped == set(), "files of config/ or launch/ that setup.py leaves out"


def test_every_console_script_has_its_launcher(scripts: dict[str, str], data_files: dict[str, list[str]]) -> None:
    """`ros2 run` starts lib/<package>/<name>: a shell script that hands over to the console script of that name."""
    launchers = {Path(file).name: ROOT / file for file in data_files[f"lib/{NAME}"]}
    assert launchers.keys() == scripts.keys()
    for name, path in launchers.items():
        assert path.stat().st_mode & 0o111 == 0o111, f"{path.name} has mode {path.stat().st_mode & 0o777:o}"
        text = path.read_text()
        assert text.startswith("#!/bin/sh\n"), (
            "a Python launcher would work only while its environment comes first in PATH"
        )
        assert f"/../../bin/{name}" in text


def test_parameter_files_are_for_our_node() -> None:
    """Every YAML file in config/ has the form that --params-file reads and is for a node named shadow_tracer."""
    for path in (ROOT / "config").glob("*.yaml"):
        content = yaml.safe_load(path.read_text())
        assert content and all(set(entry) == {"ros__parameters"} for entry in content.values()), path.name
        assert all(key.split("/")[-1] in (NAME, "**") for key in content), f"{path.name} is for {sorted(content)}"


def test_typed_marker_is_shipped(setup_arguments: dict[str, Any]) -> None:
    """Type checkers read our annotations only when py.typed is installed."""
    assert (ROOT / NAME / "py.typed").is_file()
    assert "py.typed" in setup_arguments["package_data"][NAME]


def test_every_folder_of_the_package_is_found(setup_arguments: dict[str, Any]) -> None:
    """A folder without __init__.py would be missing in the wheel while everything works from the source tree."""
    with_code = {path.parent.relative_to(ROOT).as_posix().replace("/", ".") for path in (ROOT / NAME).rglob("*.py")}
    assert set(setup_arguments["packages"]) == with_code


def test_colcon_can_read_the_metadata_back(setup_arguments: dict[str, Any]) -> None:
    """colcon passes the metadata on as text and evaluates it as literals, so it must consist of those."""
    assert ast.literal_eval(repr(setup_arguments)) == setup_arguments
