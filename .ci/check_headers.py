# SPDX-License-Identifier: Apache-2.0
"""clang-tidy over every C++ header of the package, read alone: with what it says it needs, and Warp as a stub.

Exit code 1 if it finds anything. ``make lint`` runs this. A text in which nothing was found is not read again: its
digest stands in ``.tidy_cache``.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import warp as wp  # noqa: E402

from shadow_tracer.gpu.device import native  # noqa: E402
from shadow_tracer.gpu.visibility import queries  # noqa: E402

_CHECKS = (
    "-*",
    "clang-diagnostic-*",
    "clang-analyzer-*",
    "bugprone-*",
    # Coordinates come in threes, and products of small integers address arrays.
    "-bugprone-easily-swappable-parameters",
    "-bugprone-implicit-widening-of-multiplication-result",
    "-bugprone-narrowing-conversions",
    # A list of numbers is an argument of a macro where a shuffle needs literals.
    "-bugprone-macro-parentheses",
    # The analyser does not follow how far scratch arrays are written.
    "-clang-analyzer-core.CallAndMessage",
    "-clang-analyzer-core.uninitialized.*",
    "-clang-analyzer-optin.cplusplus.UninitializedObject",
    "-clang-analyzer-core.UndefinedBinaryOperatorResult",
    "-clang-analyzer-security.insecureAPI.*",
)
_PASSED = ROOT / ".tidy_cache"
# Arguments that are arrays of several types.
_ARRAYS = {"Depth": "typedef wp::array_t<float> Depth;\n"}
_FLAGS = (
    "-std=c++17",
    "-Wall",
    "-Wextra",
    "-Wno-unknown-pragmas",
    "-Wno-unused-parameter",
    "-Wno-vla-extension",
    "-Wno-bitwise-instead-of-logical",
    "-Wno-missing-field-initializers",
)


def _structs() -> dict[str, dict[str, Any]]:
    """Warp's structs of the package, by name, then by the room they stand in."""
    found: dict[str, dict[str, Any]] = {}
    for path in sorted(native.ROOT.rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for key, value in vars(importlib.import_module(name)).items():
            if type(value).__name__ == "Struct":
                found.setdefault(key, {})[str(path.parent.relative_to(native.ROOT))] = value
    return found


def _declarations(name: str, struct: Any, found: dict[str, str]) -> None:
    """Add the declaration of a struct by ``name`` to ``found``, behind those of the structs that it holds by the names
    that Warp gives them."""
    ctype = wp._src.codegen.Var.type_to_ctype
    for var in struct.vars.values():
        held = getattr(var.type, "dtype", var.type)
        if type(held).__name__ == "Struct" and ctype(held) not in found:
            _declarations(ctype(held), held, found)
    members = " ".join(f"{ctype(var.type)} {key};" for key, var in struct.vars.items())
    found[name] = f"struct {name} {{ {members} }};\n"


def _unit(header: str, lanes: int, structs: dict[str, dict[str, Any]]) -> str:
    # A walk for one query alone names that; others are read with the one that plays the role by default.
    own_query = {query.header for query in queries.ALL} & set(native.read(header).needs)
    roles = {**native.ROLES, **({"query": own_query.pop()} if own_query else {})}
    needed = native.closure((f"{header}@{lanes}" if native.read(header).lanes else header,), roles=roles)
    text = (ROOT / ".ci" / "warp_stub.h").read_text()
    declared: dict[str, str] = {}
    for kind in dict.fromkeys(kind for each in needed.values() for kind, _ in each.arguments):
        if kind in _ARRAYS:
            text += _ARRAYS[kind]
            continue
        if kind == "Asked":
            struct = next(query.asked for query in queries.ALL if query.header in {name for name, _ in needed})
        else:
            rooms = structs[kind]
            # That of its room, or of the room of what plays a role in it.
            near = [str(Path(name).parent) for name in (header, *(name for name, _ in needed))]
            struct = next((rooms[room] for room in near if room in rooms), next(iter(rooms.values())))
        own = wp._src.codegen.Var.type_to_ctype(struct)
        if own in declared:
            declared[kind] = f"typedef {own} {kind};\n"
        else:
            _declarations(kind, struct, declared)
            declared[own] = f"typedef {kind} {own};\n"
    return text + "".join(declared.values()) + native.paste(needed)


def _check(header: str, lanes: int, unit: str, folder: Path) -> str:
    rules = (f"--checks={','.join(_CHECKS)}", "--warnings-as-errors=*")
    tidy = Path(sys.executable).with_name("clang-tidy")
    known = "\0".join((version("clang-tidy"), *rules, *_FLAGS, unit))
    passed = _PASSED / hashlib.sha256(known.encode()).hexdigest()
    if passed.exists():
        return ""
    file = folder / f"{header.replace('/', '_')}.{lanes}.cpp"
    file.write_text(unit)
    command = [str(tidy), "--quiet", *rules, str(file), "--", *_FLAGS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        passed.touch()
        return ""
    return f"{header} at {lanes} lanes\n{done.stdout}{done.stderr}"


def main() -> int:
    """Check all headers; returns the exit code."""
    wp.config.quiet = True
    _PASSED.mkdir(exist_ok=True)
    structs = _structs()
    names = sorted(path.relative_to(native.ROOT).as_posix() for path in native.ROOT.rglob("*.h"))
    cases = [(name, lanes) for name in names for lanes in ((1, 16) if native.read(name).lanes else (1,))]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [pool.submit(_check, *case, _unit(*case, structs), Path(folder)) for case in cases]
        found = [text for text in (job.result() for job in jobs) if text]
    print("\n".join(found) if found else f"{len(names)} headers checked")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
