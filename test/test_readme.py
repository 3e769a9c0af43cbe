# SPDX-License-Identifier: Apache-2.0
"""What the README and the pages in docs say is so: code runs and gives the stated results, tables equal the code, links
lead somewhere."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from shadow_tracer.ros.parameters import markdown_table

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
OTHERS = [ROOT / "CONTRIBUTING.md", ROOT / "QUALITY_DECLARATION.md", ROOT / "benchmark" / "README.md"]
PAGES = [README, *OTHERS, *sorted((ROOT / "docs").glob("*.md"))]
IDS = [page.relative_to(ROOT).as_posix() for page in PAGES]
FOR_USERS = [README, *(ROOT / "docs" / f"{name}.md" for name in ("node", "troubleshooting", "integration"))]

_BLOCK = re.compile(r"^```(.*)\n((?:.*\n)*?)```$", re.MULTILINE)
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")
_RESULT = "  # -> "
# Files that programs or users make; the pages speak of them, no checkout has them.
_MADE = {"demo_output/", "my.yaml", "install/setup.bash", "dist/", "contact_sheet.png", "reliable.yaml"}


def blocks(page: Path, language: str) -> list[str]:
    """The code blocks of a page whose opening fence says exactly this language."""
    return [text for opening, text in _BLOCK.findall(page.read_text(encoding="utf-8")) if opening == language]


def results(code: str) -> Iterator[tuple[str, str]]:
    """Pairs of the repr that a comment ``# -> ...`` promises and the one that came, from running the code."""
    names: dict[str, Any] = {}
    lines = code.splitlines()
    for statement in ast.parse(code).body:
        source = ast.unparse(statement)
        if isinstance(statement, ast.Expr):
            value = eval(compile(source, "README.md", "eval"), names)
            _, arrow, promised = lines[(statement.end_lineno or statement.lineno) - 1].partition(_RESULT)
            if arrow:
                yield promised, repr(value)
        else:
            exec(compile(source, "README.md", "exec"), names)


def prose(page: Path) -> str:
    """A page without its code blocks."""
    return _BLOCK.sub("", page.read_text(encoding="utf-8"))


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """The module rclpy, on this machine only, shut down afterwards."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))
    os.environ.setdefault("ROS_LOG_DIR", str(tmp_path))
    rclpy = pytest.importorskip("rclpy", reason="needs rclpy: pip install 'shadow_tracer[ros]'")
    yield rclpy
    rclpy.try_shutdown()


def test_the_code_for_the_library_gives_what_its_comments_say() -> None:
    code = blocks(README, "python")
    assert len(code) == 1, "one block for the library"
    pairs = list(results(code[0]))
    assert len(pairs) == code[0].count(_RESULT) == 7
    for promised, came in pairs:
        assert came == promised


@pytest.mark.ros
def test_the_code_for_the_node_gives_what_its_comments_say(ros: Any) -> None:
    code = blocks(README, "python ros")
    assert len(code) == 1, "one block that publishes a mesh"
    pairs = list(results(code[0]))
    assert len(pairs) == code[0].count(_RESULT) == 1
    for promised, came in pairs:
        assert came == promised


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_code_compiles(page: Path) -> None:
    for language in ("python", "python ros"):
        for code in blocks(page, language):
            compile(code, page.name, "exec")
    for code in blocks(page, "yaml"):
        yaml.safe_load(code)


def test_the_parameter_table_is_the_one_the_code_prints() -> None:
    text = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    found = re.search(r"^<!-- parameters: begin.*?-->\n(.*)^<!-- parameters: end -->$", text, re.DOTALL | re.MULTILINE)
    assert found, "docs/node.md has no parameter table between its two comments"
    assert found.group(1) == markdown_table(), "put what `python -m shadow_tracer.ros.parameters` prints there"


def test_the_parameters_in_the_readme_are_rows_of_that_table() -> None:
    found = re.search(r"^### Parameters\n(.*?)^#", README.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert found, "README.md has no section 'Parameters'"
    rows = re.findall(r"^\|.*\n", found.group(1), re.MULTILINE)
    assert len(rows) == 2 + 5, "a head and five parameters"
    assert set(rows) <= set(markdown_table().splitlines(keepends=True))


def topics_in_the_readme(heading: str) -> dict[str, str]:
    """Name -> package/Type of the table of topics or services under a heading."""
    section = re.search(rf"^### {heading}\n(.*?)^#", README.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert section, f"README.md has no section {heading!r}"
    return dict(re.findall(r"^\| `([^`]+)` \| ([\w/]+)", section.group(1), re.MULTILINE))


def topics_of(listed: list[tuple[str, list[str]]]) -> dict[str, str]:
    """Name -> package/Type as the README writes them, without what rclpy itself adds to every node."""
    topics = {}
    for name, (kind, *_) in listed:
        if name in ("/rosout", "/parameter_events", "/clock"):
            continue
        name = name.replace("/mask/lamp", "/mask/<light>").replace("/lights/lamp/", "/lights/<light>/")
        topics[re.sub("^/shadow_tracer/", "~/", name)] = re.sub("/(msg|srv)/", "/", kind)
    return topics


@pytest.mark.ros
def test_the_tables_are_the_topics_and_services_of_the_node(ros: Any) -> None:
    from harness import Rig

    with Rig() as rig:
        assert rig.node
        inputs = topics_of(rig.friend.get_subscriber_names_and_types_by_node("shadow_tracer", "/"))
        outputs = topics_of(rig.friend.get_publisher_names_and_types_by_node("shadow_tracer", "/"))
        services = topics_of(rig.friend.get_service_names_and_types_by_node("shadow_tracer", "/"))
    wanted = topics_in_the_readme("Topics in")
    assert {name if name.startswith("~") else f"/{name}": kind for name, kind in wanted.items()} == inputs
    assert topics_in_the_readme("Topics out") == outputs
    assert topics_in_the_readme("Services") == {
        name: kind for name, kind in services.items() if not kind.startswith(("rcl_interfaces/", "type_description_"))
    }


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_links_lead_somewhere(page: Path) -> None:
    for target in _LINK.findall(prose(page)):
        if re.match(r"https?://", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        assert file.exists(), f"{page.name} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}
            assert anchor in anchors, f"{page.name} links to {target}"


@pytest.mark.parametrize("page", FOR_USERS, ids=lambda page: page.name)
def test_files_and_make_targets_named_in_pages_exist(page: Path) -> None:
    """What looks like a path in `code`, and every `make <target>`."""
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    places = (ROOT, ROOT / "shadow_tracer", ROOT / "docs", ROOT / "test")
    text = page.read_text(encoding="utf-8")
    for code in _CODE.findall(prose(page)):
        if re.fullmatch(r"[\w.\-/]+(?:/|\.(?:py|md|yaml|xml|toml|cfg|rst|png))", code) and code not in _MADE:
            assert any((place / code).exists() for place in places), f"{page.name} names {code}"
    commands = "\n".join([*_CODE.findall(text), *blocks(page, "")])
    for target in re.findall(r"^(?:[A-Z]+=\S+ )?make ([a-z]+)", commands, re.MULTILINE):
        assert target in targets, f"{page.name} names make {target}"


def test_pictures_are_small() -> None:
    sizes = [path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()]
    assert sizes and max(sizes) < 256_000


@pytest.mark.parametrize("page", FOR_USERS, ids=lambda page: page.name)
def test_lines_can_be_read_without_wrapping(page: Path) -> None:
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        assert len(line) <= 120 or line.startswith("|"), f"{page.name}, line {number}"
