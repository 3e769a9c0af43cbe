# SPDX-License-Identifier: Apache-2.0
"""Registers, local frame and shared memory of every kernel on sm_90 are within a written budget."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark import kernel_budget
from benchmark.kernel_resources import Kernel, excess, modules, read_kernels

wp = pytest.importorskip("warp")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def kernels(machine_code: Callable[[str], Path]) -> dict[str, list[Kernel]]:
    """All compiled kernels by name; a generic kernel is several."""
    found: dict[str, list[Kernel]] = {}
    for module in modules():
        for kernel in read_kernels(module, machine_code(module)):
            found.setdefault(kernel.name, []).append(kernel)
    return found


def test_all_kernels_are_read(kernels: dict[str, list[Kernel]]) -> None:
    sources = (
        kernel for module in modules() for kernel in wp.get_module(f"shadow_tracer.gpu.{module}").kernels.values()
    )
    written = {f"{kernel.module.name.removeprefix('shadow_tracer.gpu.')}/{kernel.key}" for kernel in sources}
    assert written == set(kernels)
    assert all(0 < each.registers <= 255 and each.code > 0 for several in kernels.values() for each in several)


def test_within_the_budget(kernels: dict[str, list[Kernel]]) -> None:
    over = [line for several in kernels.values() for each in several for line in excess(each)]
    assert not over, "less is faster; else write the reason into benchmark/kernel_budget.py:\n" + "\n".join(over)


def test_exceptions_have_a_kernel_and_a_reason(kernels: dict[str, list[Kernel]]) -> None:
    assert set(kernel_budget.EXCEPTIONS) <= set(kernels), "a kernel has gone: so should its exception"
    for name, allowed in kernel_budget.EXCEPTIONS.items():
        assert len(allowed.reason) > 10, name
        default = kernel_budget.DEFAULT
        assert allowed.registers > default.registers or allowed.frame > default.frame, f"{name} is no exception"


def test_budgets_are_tight(kernels: dict[str, list[Kernel]]) -> None:
    """With room for another compiler, and no more: else what a kernel grows by goes unnoticed."""
    for name, allowed in kernel_budget.EXCEPTIONS.items():
        for what, slack in (("registers", 16), ("frame", 32)):
            used = max(getattr(each, what) for each in kernels[name])
            limit = max(getattr(kernel_budget.DEFAULT, what), 1.25 * used + slack)
            assert getattr(allowed, what) <= limit, f"{name} has {what} {used}: tighten its budget"


# What the gate would have to notice: a local array indexed at run time, and shared memory.
_KNOWN = """
import warp as wp

@wp.func_native("float kept[100]; for (int k = 0; k < 100; ++k) kept[(k * step) % 100] = values.data[k];"
                "return kept[step % 100] + kept[(3 * step) % 100];")
def gather(step: int, values: wp.array(dtype=float)) -> float:
    ...

@wp.func_native("__shared__ float kept[1000]; kept[threadIdx.x] = x; __syncthreads(); return kept[255 - threadIdx.x];")
def mirror(x: float) -> float:
    ...

@wp.kernel(enable_backward=False)
def frame(step: int, values: wp.array(dtype=float)):
    values[wp.tid()] = gather(step + wp.tid(), values)

@wp.kernel(enable_backward=False)
def shared(values: wp.array(dtype=float)):
    values[wp.tid()] = mirror(values[wp.tid()])
"""


def test_figures_are_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not wp.get_cuda_supported_archs():
        pytest.skip("this build of Warp has no CUDA compiler")
    name = "kernels_with_known_needs"
    (tmp_path / f"{name}.py").write_text(_KNOWN)
    monkeypatch.syspath_prepend(str(tmp_path))
    wp.compile_aot_module(__import__(name), arch=90, module_dir=str(tmp_path / "code"), use_ptx=False)
    (code,) = (tmp_path / "code").glob("*.cubin")
    found = {kernel.name: kernel for kernel in read_kernels("known", code)}
    assert found["known/frame"].frame in range(400, 500)
    assert found["known/shared"].shared == kernel_budget.DEFAULT.shared + 4000
    assert found["known/shared"].frame == 0
    assert [line.split(":")[0] for kernel in found.values() for line in excess(kernel)] == [
        "known/frame",
        "known/shared",
    ]


def test_what_is_no_machine_code_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.cubin").write_bytes(b"\x7fELF\x01\x01" + bytes(100))
    with pytest.raises(ValueError, match="data: expected a 64-bit"):
        read_kernels("module", tmp_path / "a.cubin")


@pytest.mark.parametrize(
    ("registers", "threads"), [(32, 2048), (40, 1536), (64, 1024), (72, 768), (128, 512), (255, 256)]
)
def test_threads_by_registers(registers: int, threads: int) -> None:
    assert Kernel("a", registers, 0, 0, 0).threads == threads
