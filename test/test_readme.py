# SPDX-License-Identifier: Apache-2.0
"""What the README and the pages in docs say is so: code runs and gives the stated results, tables equal the code, links
lead somewhere."""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib.util
import io
import os
import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import setuptools
import yaml

import shadow_tracer
from shadow_tracer.apps.bag import bag
from shadow_tracer.apps.terrain import terrain
from shadow_tracer.ros.parameters.parameters import markdown_table

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
OTHERS = [ROOT / "CONTRIBUTING.md", ROOT / "QUALITY_DECLARATION.md", ROOT / "benchmark" / "README.md"]
PAGES = [README, *OTHERS, *sorted((ROOT / "docs").glob("*.md"))]
IDS = [page.relative_to(ROOT).as_posix() for page in PAGES]
DOCS = ROOT / "docs"
NODE, LIBRARY, INSTALL, RECORDINGS, DOSE = (
    DOCS / f"{name}.md" for name in ("node", "library", "install", "recordings", "dose")
)
TERRAIN = DOCS / "terrain.md"
FOR_USERS = [README, NODE, LIBRARY, INSTALL, RECORDINGS, DOSE]
FOR_USERS += [DOCS / f"{name}.md" for name in ("troubleshooting", "integration", "slam", "testing", "terrain")]

_BLOCK = re.compile(r"^```(.*)\n((?:.*\n)*?)```$", re.MULTILINE)
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")
_RESULT = "  # -> "
# Files that programs or users make; the pages speak of them, no checkout has them.
_MADE = {
    "demo_output/",
    "my.yaml",
    "install/setup.bash",
    "dist/",
    "contact_sheet.png",
    "reliable.yaml",
    "metadata.yaml",
}


def blocks(page: Path, language: str) -> list[str]:
    """The code blocks of a page whose opening fence says exactly this language."""
    return [text for opening, text in _BLOCK.findall(page.read_text(encoding="utf-8")) if opening == language]


def results(code: str) -> Iterator[tuple[str, str]]:
    """Pairs of what a comment ``# -> ...`` promises and what came, from running the code: the repr of an expression, or
    the line that a call of ``print`` wrote."""
    names: dict[str, Any] = {}
    lines = code.splitlines()
    for statement in ast.parse(code).body:
        source = ast.unparse(statement)
        if isinstance(statement, ast.Expr):
            with contextlib.redirect_stdout(io.StringIO()) as written:
                value = eval(compile(source, "README.md", "eval"), names)
            _, arrow, promised = lines[(statement.end_lineno or statement.lineno) - 1].partition(_RESULT)
            if arrow:
                yield promised, written.getvalue().rstrip("\n") if source.startswith("print(") else repr(value)
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


def section(page: Path, heading: str) -> str:
    """The text under a heading such as "### Services", up to the next heading of any level."""
    found = re.search(rf"^{heading}\n(.*?)(?=^#|\Z)", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert found, f"{page.name} has no section {heading!r}"
    return found.group(1)


def rows(text: str) -> list[list[str]]:
    """The cells of the only table in a text, without its head."""
    table = [line.strip("|\n").split("|") for line in re.findall(r"^\|.*\n", text, re.MULTILINE)]
    assert table and set("".join(table[1])) <= set("-:"), "one table"
    return [[cell.strip() for cell in row] for row in table[2:]]


@pytest.mark.parametrize(
    ("page", "count"),
    [(README, 1), (LIBRARY, 8), (DOSE, 3), (TERRAIN, 6)],
    ids=["README.md", "docs/library.md", "docs/dose.md", "docs/terrain.md"],
)
def test_the_code_for_the_library_gives_what_its_comments_say(page: Path, count: int) -> None:
    if page == TERRAIN:
        for name in ("dask", "ephem", "xarray"):
            pytest.importorskip(name, reason="needs the extras: pip install 'shadow_tracer[terrain,fleet]'")
    code = blocks(page, "python")
    assert len(code) == 1, "one block for the library"
    pairs = list(results(code[0]))
    assert len(pairs) == code[0].count(_RESULT) == count
    for promised, came in pairs:
        assert came == promised


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 150
    lines = [line for line in blocks(README, "python")[0].splitlines() if line.strip()]
    assert len(lines) == 12, "it says twelve lines"
    ros = section(README, "## Six lines of ROS").split("```")[1]
    assert len(ros.strip().splitlines()) == 6, "it says six lines"
    bullets = re.findall(r"^- \*\*(\w+)", section(README, "## Why this one"), re.MULTILINE)
    assert bullets == ["Exact", "Dynamic", "Honest"]


def test_the_readme_counts_the_lines_of_the_page_on_testing() -> None:
    code = blocks(DOCS / "testing.md", "python test")
    assert len(code) == 1
    assert len([line for line in code[0].splitlines() if line.strip()]) == 20, "it says twenty lines"


def test_the_glossary_is_short() -> None:
    assert 12 <= len(rows(section(ROOT / "CONTRIBUTING.md", "## Words"))) <= 20


@pytest.mark.ros
def test_the_code_for_the_node_gives_what_its_comments_say(ros: Any) -> None:
    code = blocks(NODE, "python ros")
    assert len(code) == 1, "one block that publishes a mesh"
    pairs = list(results(code[0]))
    assert len(pairs) == code[0].count(_RESULT) == 1
    for promised, came in pairs:
        assert came == promised


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_code_compiles(page: Path) -> None:
    for language in ("python", "python ros", "python test"):
        for code in blocks(page, language):
            compile(code, page.name, "exec")
    for code in blocks(page, "yaml"):
        yaml.safe_load(code)


def test_the_parameter_table_is_the_one_the_code_prints() -> None:
    text = NODE.read_text(encoding="utf-8")
    found = re.search(r"^<!-- parameters: begin.*?-->\n(.*)^<!-- parameters: end -->$", text, re.DOTALL | re.MULTILINE)
    assert found, "docs/node.md has no parameter table between its two comments"
    assert found.group(1) == markdown_table(), "put what `python -m shadow_tracer.ros.parameters` prints there"


def test_the_parameters_needed_first_are_rows_of_that_table() -> None:
    lines = re.findall(r"^\|.*\n", section(NODE, "### Needed first"), re.MULTILINE)
    assert len(lines) == 2 + 5, "a head and five parameters"
    assert set(lines) <= set(markdown_table().splitlines(keepends=True))


def test_the_table_of_extras_is_what_setup_py_says(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments: dict[str, Any] = {}
    monkeypatch.setattr(setuptools, "setup", arguments.update)
    monkeypatch.chdir(ROOT)
    runpy.run_path("setup.py", run_name="__main__")
    names = {
        extra: sorted(re.split(r"[\[<>=~!]", requirement)[0] for requirement in requirements)
        for extra, requirements in arguments["extras_require"].items()
    }
    listed = {
        extra.strip("`"): sorted(_CODE.findall(brings)) for extra, _, brings in rows(section(INSTALL, "## Extras"))
    }
    assert listed == names


def test_the_table_of_the_library_has_every_public_name() -> None:
    listed = [name for names, _ in rows(section(LIBRARY, "## What there is")) for name in _CODE.findall(names)]
    assert sorted(listed) == sorted(shadow_tracer.__all__)


@pytest.mark.parametrize(
    ("program", "page", "heading"),
    [(bag, RECORDINGS, "## Run it"), (terrain, TERRAIN, "## One command")],
    ids=["bag", "terrain"],
)
def test_the_table_of_a_program_has_every_option(
    program: Any, page: Path, heading: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    known: set[str] = set()
    add = argparse.ArgumentParser.add_argument

    def listen(parser: argparse.ArgumentParser, *names: Any, **rest: Any) -> argparse.Action:
        known.update(name for name in names if name.startswith("--"))
        return add(parser, *names, **rest)

    monkeypatch.setattr(argparse.ArgumentParser, "add_argument", listen)
    with pytest.raises(SystemExit), contextlib.redirect_stdout(io.StringIO()):
        program.main(["--help"])
    text = section(page, heading).split("<!-- held equal to the program")[1]
    listed = [name.split()[0] for names, _ in rows(text) for name in _CODE.findall(names)]
    assert sorted(name for name in listed if name.startswith("--")) == sorted(known - {"--help"})


def test_the_figures_of_the_readme_are_those_of_the_page_on_performance() -> None:
    """By scene and column: ours is the default pipeline, that of wp.Mesh the better of its two."""
    page = (DOCS / "performance.md").read_text(encoding="utf-8")

    def figures(head: str, first: str) -> list[str]:
        """Open3D, Embree and `wp.Mesh` behind `light_grid` in the row of a table, by the names of the columns."""
        table = page[page.index(head) :].split("\n\n")[0].splitlines()
        names = [name.strip(" `") for name in table[0].strip("|").split("|")]
        row = next(line for line in table if line.startswith(f"| {first} |"))
        cells = dict(zip(names, (cell.strip() for cell in row.strip("|").split("|")), strict=True))
        best = {name: cell.split()[0] for name, cell in cells.items()}
        mesh = min(best["wp.Mesh refit"], best["wp.Mesh build"], key=float)
        return [best["light_grid"], best["Open3D build"], best["Embree build"], mesh]

    table = rows(section(README, "## Performance"))
    assert len(table) == 5
    for name, triangles, *cells in table[:3]:
        assert f"| {name} | {triangles} |" in page
        assert cells == figures("| dynamic, ms |", name)
    assert table[3][2:] == figures("| lights | `auto`", "16")
    assert f"**{table[4][2]} ms**" in page


def topics_listed(heading: str) -> dict[str, str]:
    """Name -> package/Type of the table of topics or services under a heading."""
    return {name.strip("`"): kind.split(",")[0] for name, kind, *_ in rows(section(NODE, f"### {heading}"))}


def topics_of(listed: list[tuple[str, list[str]]]) -> dict[str, str]:
    """Name -> package/Type as docs/node.md writes them, without what rclpy itself adds to every node."""
    topics = {}
    for name, (kind, *_) in listed:
        if name in ("/rosout", "/parameter_events", "/clock"):
            continue
        name = re.sub("/(mask|visibility|irradiance)/lamp", r"/\1/<light>", name).replace(
            "/lights/lamp/", "/lights/<light>/"
        )
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
    absent = "" if importlib.util.find_spec("grid_map_msgs") else "grid_map_msgs/GridMap"  # not on the package index
    wanted = {name: kind for name, kind in topics_listed("Topics in").items() if kind != absent}
    assert {name if name.startswith("~") else f"/{name}": kind for name, kind in wanted.items()} == inputs
    assert {name: kind for name, kind in topics_listed("Topics out").items() if kind != absent} == outputs
    assert topics_listed("Services") == {
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
    for path in (DOCS / "images").iterdir():
        assert path.stat().st_size < (3_000_000 if path.suffix == ".gif" else 256_000), path.name


@pytest.mark.parametrize("page", FOR_USERS, ids=lambda page: page.name)
def test_lines_can_be_read_without_wrapping(page: Path) -> None:
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        assert len(line) <= 120 or line.startswith("|"), f"{page.name}, line {number}"


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.name)
def test_prose_in_docs_is_100_wide(page: Path) -> None:
    """Tables, code, comments and pictures cannot be wrapped."""
    for line in prose(page).splitlines():
        assert len(line) <= 100 or line.startswith(("|", "    ", "<!--", "![")), f"{page.name}: {line}"


def test_files_that_are_named_exist() -> None:
    """In docs and in the text of the package: a file that has moved or gone is not named any more."""
    there = {path.name for name in ("shadow_tracer", "test", "benchmark", ".ci") for path in (ROOT / name).rglob("*.*")}
    pages = [*DOCS.glob("*.md"), README, ROOT / "CONTRIBUTING.md", *(ROOT / "shadow_tracer").rglob("*.py")]
    named = {
        (name.split("/")[-1], page.name)
        for page in pages
        for name in re.findall(r"`([\w/]+\.(?:py|h))(?=[:`])", page.read_text(encoding="utf-8"))
    }
    assert len(named) > 100
    examples = {"setup.py", "name.h", "n.h"}  # a file of the user, a pattern, and a dot product
    missing = sorted((name, page) for name, page in named if name not in there | examples)
    assert not missing, missing
