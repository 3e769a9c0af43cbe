# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the core suite: every test that takes `tracer` runs on every device found and on every pipeline and
variant there is, on some in both forms of kernels."""

from __future__ import annotations

import os
import sys
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import few_cases
import last_bits
import orders
import probe
import pytest
import slow_cases

# Small enough to be made once per pipeline, large enough for every real mesh of the suite.
BOUNDS = {
    "max_triangles": 400_000,
    "max_rays": 80_000,
    "max_lights": 16,
    "queue_capacity": 200_000,
    "grid_entries": 1_000_000,
}


_GPU = Path(__file__).parent / "gpu"
_HOW_IT_RAN = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("kernels", "in which form and order the CPU runs kernels")
    group.addoption(
        "--kernel-form",
        choices=["cuda"],
        help="run on the CPU what a CUDA thread runs",
    )
    group.addoption("--task-order", choices=sorted(orders.ORDERS), help="order of the tasks of each launch on the CPU")
    group.addoption("--task-seed", type=int, default=1, help="chooses among the random task orders (default: 1)")
    group.addoption("--last-bits", type=int, metavar="SEED", help="run with another numpy, see test/last_bits.py")

    group = parser.getgroup("inner loop", "what make quick leaves out")
    group.addoption("--default-variants", action="store_true", help="of each pipeline its default variant alone")
    group.addoption("--few-cases", type=int, metavar="N", help="of each function N of its cases at most; 0: all")
    group.addoption("--find-slow", action="store_true", help="name cases that want the mark slow")


def pytest_configure(config: pytest.Config) -> None:
    how: list[str] = []
    if config.getoption("--kernel-form"):
        assert "shadow_tracer.gpu.device.forms" not in sys.modules, (
            "the form is chosen once, before anything asks for it"
        )
        os.environ["SHADOW_TRACER_FORM"] = config.getoption("--kernel-form")
        how.append(f"kernel form: {config.getoption('--kernel-form')}")
    if config.getoption("--task-order"):
        order, seed = config.getoption("--task-order"), config.getoption("--task-seed")
        how.append(f"task order: {order}, seed {seed}, kernels in {orders.install(order, seed)}")
    if config.getoption("--last-bits") is not None:
        last_bits.install(config.getoption("--last-bits"))
        how.append(f"last bits: other ones, seed {config.getoption('--last-bits')}")
    if config.getoption("--few-cases"):
        config.pluginmanager.register(few_cases.Few(config.getoption("--few-cases")), "few cases")
    if config.getoption("--find-slow"):
        config.pluginmanager.register(slow_cases.Meter(config), "slow cases")
    config.stash[_HOW_IT_RAN] = how


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """How to run the same again; the header that usually says it is missing from quiet runs."""
    if config.pluginmanager.hasplugin("randomly"):
        config.stash[_HOW_IT_RAN].append(f"test order: random, --randomly-seed={config.getoption('randomly_seed')}")
    for line in config.stash[_HOW_IT_RAN]:
        terminalreporter.write_line(line)


def _devices() -> list[str]:
    """Asked once, at collection: "cpu", and "cuda:0" where Warp sees one. SHADOW_TRACER_TEST_DEVICES=cpu,cuda:0
    overrides."""
    named = os.environ.get("SHADOW_TRACER_TEST_DEVICES")
    if named:
        return named.split(",")
    import warp

    warp.config.quiet = True
    return ["cpu", "cuda:0"] if warp.is_cuda_available() else ["cpu"]


# The CPU runs their default variants in the form of a CUDA thread, too.
_IN_CUDA_FORM = ("light_grid", "cone_hierarchy", "brute_force")


def _cases(default_variants: bool) -> list[tuple[tuple[str, str, str], str]]:
    """(device, pipeline, variant), and the form of its kernels."""
    from shadow_tracer import available_pipelines

    cases = []
    for device in _devices():
        for name, variants in available_pipelines().items():
            cases += [((device, name, each), probe.USUAL) for each in (variants[:1] if default_variants else variants)]
            if name in _IN_CUDA_FORM and not default_variants and probe.wide(device):
                cases.append(((device, name, variants[0]), probe.CUDA))
            if name == "light_grid" and not default_variants and probe.wide(device):
                cases.append(((device, name, variants[0]), probe.EVERY_PAIR))
    return cases


class Tracers:
    """Tracers by (device, pipeline, variant) with the suite's bounds, of the form that the CPU takes at the moment;
    made on first use, and on every request in the state of a fresh one, whatever tests ran before."""

    def __init__(self) -> None:
        self._made: dict[tuple[str, bool, str, str], Any] = {}

    def __call__(self, device: str, pipeline: str, variant: str) -> Any:
        from shadow_tracer import Bounds, ShadowTracer

        key = (device, probe.wide(device), pipeline, variant)
        if key not in self._made:
            self._made[key] = ShadowTracer(pipeline=pipeline, variant=variant, device=device, bounds=Bounds(**BOUNDS))
        probe.reset(self._made[key])
        return self._made[key]


@pytest.fixture(scope="session")
def tracers() -> Tracers:
    return Tracers()


# Of each case of the general tests these get all, in both forms where ``_IN_CUDA_FORM`` says so. All others share most
# of their code with one of them, or are there to be compared with: they take turns, one case in six for each; of the
# views one in three; the slowest ones get few of the slow cases.
# SHADOW_TRACER_ALL_CASES=1 gives every case to every variant, as their own tests always do.
_IN_ALL_CASES = ("light_grid-packed", "cone_hierarchy-linear", "mesh_bvh-refit", "brute_force-filtered")
_SLOWEST = ("bsp", "ray_classification", "cone_hierarchy-spheres", "cone_hierarchy-precise", "brute_force-float64")
_TURNS, _TURNS_OF_VIEWS, _TURNS_OF_SLOW = 6, 3, 24
_FOR_ALL = ("test_front_face_culling", "cone_hierarchy", "test_probe")


def _takes_turns(pipeline: str, variant: str, form: str) -> bool:
    some = form == probe.EVERY_PAIR or (form == probe.CUDA and pipeline == "brute_force")
    return some or f"{pipeline}-{variant}" not in _IN_ALL_CASES


@cache
def _takers(device: str) -> list[tuple[tuple[str, str, str], str]]:
    """Those that take turns."""
    return [(case, form) for case, form in _cases(False) if case[0] == device and _takes_turns(*case[1:], form)]


def _turn(item: pytest.Item) -> bool:
    """Whether a case is one that its variant takes: neighbouring variants take other ones."""
    params = item.callspec.params  # type: ignore[attr-defined]
    device, pipeline, variant = case = params["tracer_case"]
    form = params["kernel_form"]
    path, slow = item.path.as_posix(), item.get_closest_marker("slow") is not None
    if not _takes_turns(pipeline, variant, form) or any(part in path for part in _FOR_ALL):
        return True
    slowest = f"{pipeline}-{variant}".startswith(_SLOWEST)
    turns = _TURNS_OF_SLOW if slow and slowest else _TURNS_OF_VIEWS if "test_views" in path else _TURNS
    name = item.nodeid.replace("-".join(case), "").replace(f"-{form}", "")
    return (zlib.crc32(name.encode()) + _takers(device).index((case, form))) % turns == 0


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    kept, left_out = [], []
    all_cases = os.environ.get("SHADOW_TRACER_ALL_CASES")
    for item in items:
        if item.path.name.endswith("safeguards_off.py"):
            item.add_marker("mutant")
        mine = not (config.getoption("--kernel-form") and item.get_closest_marker("wide"))
        if mine and not all_cases and "tracer_case" in getattr(getattr(item, "callspec", None), "params", {}):
            mine = _turn(item)
        (kept if mine else left_out).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = kept


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "tracer_case" in metafunc.fixturenames:
        cases = _cases(metafunc.config.getoption("--default-variants"))
        ids = ["-".join(case if form == probe.USUAL else [*case, form]) for case, form in cases]
        metafunc.parametrize(("tracer_case", "kernel_form"), cases, ids=ids, scope="session", indirect=["kernel_form"])
    elif "any_device" in metafunc.fixturenames:
        metafunc.parametrize("any_device", _devices(), scope="session")


@pytest.fixture(autouse=True)
def kernel_form(request: pytest.FixtureRequest) -> Iterator[str]:
    """The form in which the CPU runs kernels as long as the test lasts, one of ``probe.FORMS`` or EVERY_PAIR: of
    parameters. Pipelines that are tested are asked about few points and triangles, too."""
    form: str = getattr(request, "param", probe.USUAL)
    with probe.form(form), ExitStack() as stack:
        if form != probe.EVERY_PAIR and ("tracer_case" in request.fixturenames or request.path.is_relative_to(_GPU)):
            stack.enter_context(probe.few_pairs(0))
        yield form


@pytest.fixture
def tracer(tracers: Tracers, tracer_case: tuple[str, str, str]) -> Iterator[Any]:
    """A tracer with an empty scene, for each device, pipeline and variant."""
    made = tracers(*tracer_case)
    yield made
    made.scene.clear()


@pytest.fixture
def reference(tracers: Tracers, any_device: str) -> Iterator[Any]:
    """A brute_force tracer with an empty scene, for each device."""
    made = tracers(any_device, "brute_force", "filtered")
    yield made
    made.scene.clear()
