# SPDX-License-Identifier: Apache-2.0
"""C++ of kernels: headers of the project, pasted into native functions.

A kernel's C++ lies in headers (``gpu/**/*.h``), which editors, formatters and linters read, and which a compiler takes
as they are. Warp gets them as text, not by ``#include``: the key of its kernel cache follows the text of a snippet, and
not that of files the snippet includes. Compile errors on the CPU name the header and its line.

A header begins with a comment. Its first lines say what it takes, each as a comment::

    // needs: exact/arithmetic.h device/lanes.h@16   other headers, each pasted once, before it; a role (ROLES) is
                                                     played by the header that a snippet names for it
    // constants: SHADOWED LEAF_TESTS                values that Python has given by ``constants``
    // arguments: Tiles tiles, Occluders occluders   names for the types of the native function's arguments, or of what
                                                     they hold
    // cpu                                           not for CUDA; nor is any text for more than one lane
    // lanes                                         written for any number of lanes

Functions are static members of structs, because a struct may stand in the body of a function, as snippets do, and at
namespace scope, where a compiler reads headers. A header for any number of lanes uses ``LANES``, ``REAL`` (a float, or
``LANES`` of them), ``MASK`` (what comparing them gives) and ``WIDE(Name)``; ``name.h@16`` is that header for sixteen,
without a number for one. What such a header needs has its own number of lanes unless it names another.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import warp as wp

ROOT = Path(__file__).resolve().parents[1]  # gpu/
_SHOWN = "shadow_tracer/gpu"  # as compilers name it

# What stands for a header in ``needs``, and the header that plays it unless a snippet names another: what is asked
# about rays (a struct ``Query``), how they go through a structure (a struct ``Walk``; both names end with the number of
# lanes), and how cones do (a struct ``ConeWalk``).
ROLES = {
    "query": "visibility/any_hit.h",
    "walk": "accelerators/brute_force/every_triangle.h",
    "cone_walk": "accelerators/bvh/cone_walk.h",
}

_constants: dict[str, int | float] = {}


def constants(**values: int | float) -> None:
    """Let headers use these values by name.

    Raises:
        ValueError: a name that has another value already.
    """
    for name, value in values.items():
        value = value if isinstance(value, float) else int(value)
        if _constants.setdefault(name, value) != value:
            raise ValueError(f"{name}: given to headers as {_constants[name]}, and now as {value}")


@dataclass(frozen=True)
class Header:
    """A header's text, and what its first lines say.

    Attributes:
        name: its path below ``gpu/``.
        lanes: whether it is written for any number of lanes.
        cpu: whether it is for the CPU alone.
        arguments: (type, argument) pairs.
    """

    name: str
    text: str
    needs: tuple[str, ...]
    constants: tuple[str, ...]
    arguments: tuple[tuple[str, str], ...]
    cpu: bool
    lanes: bool


@cache
def read(name: str) -> Header:
    """The header ``name``, a path below ``gpu/``."""
    text = (ROOT / name).read_text(encoding="utf-8")
    said: dict[str, str] = {}
    for line in text.splitlines():
        match = re.fullmatch(r"// (needs|constants|arguments|cpu|lanes)(?:: *(.*))?", line)
        if match:
            said[match[1]] = f"{said.get(match[1], '')} {match[2] or ''}"
        elif not line.startswith("// "):
            break
    pairs = [pair.split() for pair in said.get("arguments", "").split(",") if pair.strip()]
    return Header(
        name,
        text,
        tuple(said.get("needs", "").split()),
        tuple(said.get("constants", "").split()),
        tuple((kind, argument) for kind, argument in pairs),
        "cpu" in said,
        "lanes" in said,
    )


def closure(names: tuple[str, ...], lanes: int = 1, roles: Mapping[str, str] = ROLES) -> dict[tuple[str, int], Header]:
    """Those headers and all that they need, by name and number of lanes, each behind what it needs; ``roles``: who
    plays them."""
    found: dict[tuple[str, int], Header] = {}
    for spelled in names:
        name, _, width = spelled.partition("@")
        name = roles.get(name, name)
        header = read(name)
        own = (int(width) if width else lanes) if header.lanes else 1
        if header.lanes or not width:
            found |= {key: value for key, value in closure(header.needs, own, roles).items() if key not in found}
            found[name, own] = header
        else:
            raise ValueError(f"{spelled}: {name} is not written for lanes")
    return found


def _value(value: int | float) -> str:
    return f"constexpr double {{}} = {value!r};" if isinstance(value, float) else f"constexpr int {{}} = {value};"


def _line(file: str) -> str:
    """Lets errors in what follows, from line 2 on, name ``file``. Not on CUDA: there it costs the precompiled headers,
    and what both compile is compiled for the CPU first."""
    return f'#if !defined(__CUDACC__)\n#line 1 "{file}"\n#endif'


def paste(headers: dict[tuple[str, int], Header]) -> str:
    """Their text, ready to be compiled.

    Raises:
        KeyError: a constant that no module has given.
    """
    parts = ["#if defined(__clang__)", '#define UNCONTRACTED _Pragma("clang fp contract(off)")']
    parts += ['#define CONTRACTED _Pragma("clang fp contract(fast)")']
    parts += ["#else", "#define UNCONTRACTED", "#define CONTRACTED", "#endif"]
    for name in dict.fromkeys(name for header in headers.values() for name in header.constants):
        if name not in _constants:
            raise KeyError(f"{name}: no module that has been imported gives it to headers")
        parts.append(_value(_constants[name]).format(name))
    for (name, lanes), header in headers.items():
        macros = {"LANES": lanes, "WIDE(name)": f"name##{lanes}", "REAL": f"Real{lanes}", "MASK": f"Mask{lanes}"}
        parts += [f"#define {macro} {text}" for macro, text in macros.items()] if header.lanes else []
        parts += [_line(f"{_SHOWN}/{name}"), header.text.partition("\n")[2].rstrip()]
        parts += [f"#undef {macro.partition('(')[0]}" for macro in macros] if header.lanes else []
    return "\n".join([*parts, "#undef UNCONTRACTED", "#undef CONTRACTED"]) + "\n"


def snippet(*names: str, call: str, otherwise: str = "", roles: Mapping[str, str] = ROLES, cpu: bool = False) -> str:
    """The snippet of a native function.

    Args:
        names: the headers that ``call`` uses.
        call: the function's body, a call.
        otherwise: the body for CUDA, where one of the headers is for the CPU alone, or for several lanes.
        roles: the headers that play the roles of ``ROLES``.
        cpu: leave the body out for CUDA, whatever the headers say.
    """
    headers = closure(names, roles=roles)
    # Of several that name a type, the one that needs the others knows where it is.
    arguments = dict(pair for header in headers.values() for pair in header.arguments)
    types = "".join(f"typedef decltype({argument}) {kind};\n" for kind, argument in arguments.items())
    where = _line(f"{_SHOWN}/{names[-1].partition('@')[0]}: call")
    body = "\n".join([types + paste(headers).rstrip(), where, call, _line("the kernel that Warp made"), ""])
    if not (cpu or any(header.cpu or lanes > 1 for (_, lanes), header in headers.items())):
        return body
    return f"#if !defined(__CUDA_ARCH__)\n{body}#else\n{otherwise}\n#endif\n"


def func_native(*names: str, calls: str, otherwise: str = "") -> Callable[[Callable[..., Any]], wp.Function]:
    """A native function that hands its arguments to ``calls`` of the last of the headers ``names``; see ``snippet``.

    Not for overloads: Warp looks for the others where ``wp.func_native`` is called. The decorator is to be written
    ``@native.func_native(...)``: by that name Warp knows that a function that returns something is native.
    """

    def make(function: Callable[..., Any]) -> wp.Function:
        returns = function.__annotations__.get("return") not in (None, "None")
        call = f"{'return ' if returns else ''}{calls}({', '.join(inspect.signature(function).parameters)});"
        made: wp.Function = wp.func_native(snippet(*names, call=call, otherwise=otherwise))(function)
        return made

    return make
