# SPDX-License-Identifier: Apache-2.0
"""What each kernel takes of an sm_90 multiprocessor: compiled ahead of time, read from the machine code; no GPU.

Prints registers, local frame and shared memory of all kernels beside their budget (``kernel_budget.py``), and how many
threads of 2,048 a multiprocessor can run of it with blocks of 256. Exit code 1 if one is over its budget.
``test/gpu/device/test_kernel_resources.py`` holds the same.
"""

from __future__ import annotations

import argparse
import re
import struct
import sys
import tempfile
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.kernel_budget import budget
from benchmark.report import ROOT, table, write_json

_GPU = ROOT / "shadow_tracer" / "gpu"
_ARCHITECTURE = 90
_BLOCK = 256  # threads, what Warp launches unless told otherwise

# Records of the section .nv.info: "attribute of a symbol, one value".
_VALUE, _REGISTERS, _FRAME, _STACK = 4, 0x2F, 0x11, 0x12


class NoCompiler(RuntimeError):
    """This build of Warp cannot compile for CUDA."""


@dataclass(frozen=True)
class Kernel:
    """A compiled kernel.

    Attributes:
        name: ``module/kernel``, the module below shadow_tracer.gpu.
        registers: per thread.
        frame: bytes of local memory per thread: its own and that of what it calls.
        shared: bytes of static shared memory per block.
        code: bytes of instructions.
    """

    name: str
    registers: int
    frame: int
    shared: int
    code: int

    @property
    def threads(self) -> int:
        """Threads of it that a multiprocessor runs at once, by registers: they are handed out to a warp in units of
        256."""
        warps = 65536 // (-(-max(self.registers, 1) * 32 // 256) * 256)
        return min(2048, warps * 32 // _BLOCK * _BLOCK)


def modules() -> list[str]:
    """Names below shadow_tracer.gpu of the modules of Warp that have kernels: those of files, and where rays walk
    through a structure one for each question."""
    found = []
    for path in sorted(_GPU.rglob("*.py")):
        name, text = ".".join(path.relative_to(_GPU).with_suffix("").parts), path.read_text()
        if re.search(r"^@wp\.kernel", text, re.M):
            found.append(name)
        if re.search(r" = Walk\(", text):
            values = list(vars(import_module(f"shadow_tracer.gpu.{name}")).values())
            held = [getattr(value, ways, None) for value in values for ways in ("walk", "cones")]
            walks = {id(walk): walk for walk in [*values, *held]}
            names = [module for walk in walks.values() for module in getattr(walk, "modules", [])]
            found += dict.fromkeys(module.removeprefix("shadow_tracer.gpu.") for module in names)
    return found


def warp_module(name: str) -> Any:
    """Warp's module of kernels, by its name in ``modules()``."""
    import warp as wp

    try:
        import_module(f"shadow_tracer.gpu.{name}")
    except ModuleNotFoundError:  # of a walk
        import_module(f"shadow_tracer.gpu.{name.rpartition('.')[0]}")
    return wp.get_module(f"shadow_tracer.gpu.{name}")


def compile_module(name: str, folder: Path) -> Path:
    """Compile a module for sm_90 into the empty ``folder``; returns the file of machine code.

    Raises:
        NoCompiler: this Warp has no CUDA compiler.
    """
    import warp as wp

    wp.init()
    if not wp.get_cuda_supported_archs():
        raise NoCompiler("this build of Warp has no CUDA compiler")
    wp.compile_aot_module(warp_module(name), arch=_ARCHITECTURE, module_dir=str(folder), use_ptx=False)
    (code,) = folder.glob("*.cubin")
    return code


class _Elf:
    """Sections and symbols of a 64-bit little-endian ELF file."""

    def __init__(self, data: bytes) -> None:
        if data[:6] != b"\x7fELF\x02\x01":
            raise ValueError("data: expected a 64-bit little-endian ELF file")
        self._data = data
        (table,) = struct.unpack_from("<Q", data, 40)
        size, count, names = struct.unpack_from("<HHH", data, 58)
        headers = [struct.unpack_from("<IIQQQQIIQQ", data, table + size * k) for k in range(count)]
        self.sizes: dict[str, int] = {}
        self._content: dict[str, bytes] = {}
        for header in headers:
            name = self._text(headers[names][4] + header[0])
            offset, length = header[4], header[5]
            self.sizes[name] = length
            self._content[name] = data[offset : offset + length]
            if name == ".symtab":
                strings = headers[header[6]][4]
                starts = (struct.unpack_from("<I", data, k)[0] for k in range(offset, offset + length, 24))
                self.symbols = [self._text(strings + start) for start in starts]

    def _text(self, offset: int) -> str:
        return self._data[offset : self._data.index(0, offset)].decode()

    def values(self) -> dict[tuple[str, int], int]:
        """(symbol, attribute) to value, of all records of .nv.info that have these."""
        content, position = self._content[".nv.info"], 0
        found = {}
        while position < len(content):
            kind, attribute, size = struct.unpack_from("<BBH", content, position)
            position += 4
            if kind == _VALUE:  # else the value is in the place of the size
                if size == 8:
                    symbol, value = struct.unpack_from("<II", content, position)
                    found[self.symbols[symbol], attribute] = value
                position += size
        return found


def read_kernels(module: str, code: Path) -> list[Kernel]:
    """The kernels in a file of machine code.

    Raises:
        ValueError: not an ELF file, or one without the records that we know.
    """
    elf = _Elf(code.read_bytes())
    values = elf.values()
    kernels = []
    for section, size in elf.sizes.items():
        symbol = section.removeprefix(".text.")
        if symbol == section:
            continue
        name = re.sub(r"_[0-9a-f]{8}_cuda_kernel_forward$", "", symbol)
        if (symbol, _REGISTERS) not in values or (symbol, _FRAME) not in values or name == symbol:
            raise ValueError(f"{code.name}: nothing is known about {symbol}")
        frame = max(values[symbol, _FRAME], values.get((symbol, _STACK), 0))
        shared = elf.sizes.get(f".nv.shared.{symbol}", 0)
        kernels.append(Kernel(f"{module}/{name}", values[symbol, _REGISTERS], frame, shared, size))
    return kernels


def excess(kernel: Kernel) -> list[str]:
    """In words, by what a kernel is over its budget."""
    allowed = budget(kernel.name)
    return [
        f"{kernel.name}: {what} {getattr(kernel, what)}, allowed are {getattr(allowed, what)}"
        for what in ("registers", "frame", "shared")
        if getattr(kernel, what) > getattr(allowed, what)
    ]


def main() -> int:
    """Compile everything and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--modules", nargs="+", default=modules(), choices=modules(), metavar="MODULE")
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    kernels: list[Kernel] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.modules:
            kernels += read_kernels(name, compile_module(name, Path(folder) / name))
    rows = []
    for kernel in sorted(kernels, key=lambda k: (-k.registers, -k.frame, k.name)):
        allowed = budget(kernel.name)
        rows.append(
            {
                "kernel": kernel.name,
                "registers": f"{kernel.registers} of {allowed.registers}",
                "frame B": f"{kernel.frame} of {allowed.frame}",
                "shared B": f"{kernel.shared} of {allowed.shared}",
                "code B": kernel.code,
                "threads": kernel.threads,
                "why": allowed.reason or "-",
            }
        )
    table(rows)
    write_json(f"Kernels compiled for sm_{_ARCHITECTURE}", [vars(kernel) for kernel in kernels], options.json)
    over = [line for kernel in kernels for line in excess(kernel)]
    print("\n".join(over) if over else f"All {len(kernels)} kernels are within their budget.")
    return bool(over)


if __name__ == "__main__":
    sys.exit(main())
