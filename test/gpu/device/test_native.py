# SPDX-License-Identifier: Apache-2.0
"""C++ headers: pasted once and in order, at any number of lanes, with constants by name; the kernel cache follows their
text, and errors name them."""

from __future__ import annotations

import ast
import importlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

wp = pytest.importorskip("warp")

from shadow_tracer.gpu.accelerators.cone_kernels import ConeKernels  # noqa: E402
from shadow_tracer.gpu.accelerators.walker import Walk  # noqa: E402
from shadow_tracer.gpu.device import native  # noqa: E402

_ROOT = Path(__file__).resolve().parents[3]
_HEADERS = sorted(path.relative_to(native.ROOT).as_posix() for path in native.ROOT.rglob("*.h"))

Write = Callable[[str, str], None]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Writes a header into a folder that stands for ``gpu/``."""
    monkeypatch.setattr(native, "ROOT", tmp_path)
    monkeypatch.setattr(native, "_constants", {"SEVEN": 7, "HALF": 0.5})
    monkeypatch.setattr(native, "read", native.read.__wrapped__)

    def put(name: str, text: str) -> None:
        (tmp_path / name).write_text(text)

    return put


def test_what_a_header_needs_stands_before_it_once(write: Write) -> None:
    write("a.h", "// first\nstruct A {};\n")
    write("b.h", "// needs: a.h\nstruct B {};\n")
    write("c.h", "// needs: b.h a.h\nstruct C {};\n")
    text = native.snippet("c.h", "a.h", call="return 1;")
    assert [text.count(f"struct {name} {{}};") for name in "ABC"] == [1, 1, 1]
    assert text.index("struct A") < text.index("struct B") < text.index("struct C") < text.index("return 1;")


def test_lanes(write: Write) -> None:
    write("plain.h", "// plain\nstruct Plain {};\n")
    write("lanes.h", "// needs: plain.h\n// lanes\nstruct WIDE(Lanes) { REAL x; };\n")
    write("user.h", "// needs: lanes.h\n// lanes\nstruct WIDE(User) {};\n")
    write("both.h", "// needs: user.h@16 user.h\nstruct Both {};\n")
    closure = native.closure(("both.h",))
    lanes = [("lanes.h", 16), ("user.h", 16), ("lanes.h", 1), ("user.h", 1)]
    assert list(closure) == [("plain.h", 1), *lanes, ("both.h", 1)]
    text = native.paste(closure)
    assert text.count("#define LANES 16") == 2 and text.count("#undef LANES") == 4
    with pytest.raises(ValueError, match=r"plain.h@16: plain.h is not written for lanes"):
        native.closure(("plain.h@16",))


def test_constants_come_by_name_and_have_one_value(write: Write) -> None:
    write("a.h", "// constants: SEVEN HALF\nstruct A {};\n")
    text = native.snippet("a.h", call="return SEVEN;")
    assert "constexpr int SEVEN = 7;" in text and "constexpr double HALF = 0.5;" in text
    native.constants(SEVEN=7, EIGHT=8)
    with pytest.raises(ValueError, match="SEVEN: given to headers as 7, and now as 8"):
        native.constants(SEVEN=8)
    write("b.h", "// constants: NINE\nstruct B {};\n")
    with pytest.raises(KeyError, match="NINE: no module that has been imported gives it to headers"):
        native.snippet("b.h", call="return 9;")


def test_what_is_for_the_cpu_is_left_out_for_cuda(write: Write) -> None:
    write("a.h", "// cpu\nstruct A {};\n")
    text = native.snippet("a.h", call="return 1;", otherwise="return 0;")
    assert text.startswith("#if !defined(__CUDA_ARCH__)\n") and text.endswith("#else\nreturn 0;\n#endif\n")


def _snippets() -> list[str]:
    """Those of all native functions of the package."""
    modules = [
        importlib.import_module(".".join(path.relative_to(_ROOT).with_suffix("").parts))
        for path in sorted((_ROOT / "shadow_tracer" / "gpu").rglob("*.py"))
    ]
    values = [value for module in modules for value in vars(module).values()]
    classes = [value for value in values if isinstance(value, type)]
    walks = [value for each in classes for value in vars(each).values() if isinstance(value, (Walk, ConeKernels))]
    walks += [value for value in values if isinstance(value, Walk)]
    functions = [value for value in values if isinstance(value, wp.Function)]
    functions += [function for walk in walks for function in walk.functions]
    return [function.native_snippet for function in functions]


def test_every_header_is_used_and_what_it_says_comes_first() -> None:
    whole = "\n".join(text for text in _snippets() if text)
    for name in _HEADERS:
        header = native.read(name)
        assert header.text.startswith("// "), f"{name}: its first line is replaced, so it must be a comment"
        assert header.text.partition("\n")[2].rstrip() in whole, f"{name}: no native function has its text"


@cache
def _imports(path: Path) -> list[Path]:
    """The files of the package that a file imports when it is imported."""
    found = []
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for name in (node.module, *(f"{node.module}.{each.name}" for each in node.names)):
                found.append(_ROOT / f"{str(name).replace('.', '/')}.py")
    return [other for other in found if other.exists()]


def _imported(path: Path, found: dict[Path, None]) -> dict[Path, None]:
    """Those, and what they import, and so on; itself first."""
    if path not in found:
        found[path] = None
        for other in _imports(path):
            _imported(other, found)
    return found


@cache
def _given(path: Path) -> tuple[set[str], set[str]]:
    """Constants that a file gives to headers, and what the names of others begin with."""
    given = re.findall(r"native\.constants\((.*?)\)\n", path.read_text(), re.S)
    names = {name for some in given for name in re.findall(r"(\w+)=", some)}
    return names, {start for some in given for start in re.findall(r'f"(\w+)\{', some)}


def test_who_pastes_a_header_imports_what_gives_its_constants() -> None:
    """Whatever else has been imported: a program may use one pipeline alone."""
    paste_for_others, pasted = {"native.py", "walker.py", "cone_kernels.py"}, 0
    for path in sorted((_ROOT / "shadow_tracer" / "gpu").rglob("*.py")):
        text = path.read_text()
        named = {name for name in re.findall(r'"([\w/]+\.h)(?:@\d+)?"', text) if name in _HEADERS}
        if not named or path.name in paste_for_others:
            continue
        walks = [name for name in named if name.endswith("/cone_walk.h")]
        roles = {**native.ROLES, "cone_walk": (walks or [native.ROLES["cone_walk"]])[0]}
        if "ConeKernels(" in text:
            named |= {"accelerators/cone_outcome.h", "accelerators/cone_hits.h"}
        headers = native.closure(tuple(sorted(named)), roles=roles).values()
        givers = [_given(each) for each in _imported(path, {})]
        names = {name for some, _ in givers for name in some}
        several = tuple(start for _, some in givers for start in some)
        wanted = {name for header in headers for name in header.constants if not name.startswith(several)}
        assert wanted <= names, (path, wanted - names)
        pasted += 1
    assert pasted > 40


_HASHES = """
import sys
sys.path.insert(0, sys.argv[1])
import importlib, warp as wp
wp.config.quiet = True
for name in ("visibility.queue", "exact.records", "samples.rays"):
    module = importlib.import_module("shadow_tracer.gpu." + name)
    print(wp.get_module(module.__name__).hash_module().hex())
"""


@pytest.mark.slow
def test_kernels_follow_the_text_of_headers(tmp_path: Path) -> None:
    """One digit in a header: other keys in the kernel cache for the modules that use it, the same for others."""
    shutil.copytree(_ROOT / "shadow_tracer", tmp_path / "shadow_tracer", ignore=shutil.ignore_patterns("__pycache__"))

    def hashes() -> list[str]:
        command = [sys.executable, "-c", _HASHES, str(tmp_path)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[-3:]

    before = hashes()
    header = tmp_path / "shadow_tracer" / "gpu" / "samples" / "project.h"
    header.write_text(header.read_text() + "// another text\n")
    after = hashes()
    assert before[:2] == after[:2] and before[2] != after[2]
    header = tmp_path / "shadow_tracer" / "gpu" / "exact" / "determinant.h"
    text = header.read_text()
    assert text.count("1.0e-15") == 1
    header.write_text(text.replace("1.0e-15", "1.1e-15"))
    last = hashes()
    assert all(one != two for one, two in zip(after[:2], last[:2], strict=True))


_WRONG = """
import sys
sys.path.insert(0, sys.argv[1])
import warp as wp
from shadow_tracer.gpu.visibility import queue
wp.load_module(queue, device="cpu")
"""


@pytest.mark.slow
def test_errors_name_the_header_and_its_line(tmp_path: Path) -> None:
    shutil.copytree(_ROOT / "shadow_tracer", tmp_path / "shadow_tracer", ignore=shutil.ignore_patterns("__pycache__"))
    header = tmp_path / "shadow_tracer" / "gpu" / "exact" / "decision.h"
    lines = header.read_text().split("\n")
    (number,) = [k for k, line in enumerate(lines, 1) if "light_side = side;" in line]
    lines[number - 1] = lines[number - 1].replace("= side", "= sied")
    header.write_text("\n".join(lines))
    done = subprocess.run(
        [sys.executable, "-c", _WRONG, str(tmp_path)],
        capture_output=True,
        text=True,
        env={**os.environ, "WARP_CACHE_PATH": str(tmp_path / "kernels")},
        check=False,
    )
    assert done.returncode != 0
    assert f"shadow_tracer/gpu/exact/decision.h:{number}:" in done.stdout + done.stderr
