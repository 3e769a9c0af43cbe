# SPDX-License-Identifier: Apache-2.0
"""The task orders of ``orders.py``: all tasks, each once, in another order; and the suite's options for them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import orders
import pytest

_TEST = Path(__file__).resolve().parent

_KERNEL = """
import sys
sys.path.insert(0, {test!r})
import orders
if {order!r}:
    print(orders.install({order!r}, {seed}))
import warp as wp
wp.config.quiet = True

@wp.kernel
def note(count: wp.array(dtype=int), order: wp.array(dtype=int)):
    order[wp.atomic_add(count, 0, 1)] = wp.tid()

for tasks in (0, 1, 2, 3, 10, 97, 96, 1024, 97, 97):
    count, order = wp.zeros(1, dtype=int, device="cpu"), wp.zeros(max(tasks, 1), dtype=int, device="cpu")
    wp.launch(note, dim=tasks, inputs=[count, order], device="cpu")
    assert count.numpy()[0] == tasks
    print("tasks", *order.numpy()[:tasks])
"""


def _orders(tmp_path: Path, order: str, seed: int = 1) -> list[list[int]]:
    """Tasks of some launches as they came; in a separate process, as kernels are compiled once."""
    program = tmp_path / f"{order or 'usual'}_{seed}.py"  # Warp reads kernels from files
    program.write_text(_KERNEL.format(test=str(_TEST), order=order, seed=seed))
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, env=environment, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    return [[int(task) for task in line[1:]] for line in lines if line[:1] == ["tasks"]]


@pytest.mark.slow
def test_all_tasks_come_once_in_the_order_asked_for(tmp_path: Path) -> None:
    usual = _orders(tmp_path, "")
    assert all(order == list(range(len(order))) for order in usual)
    assert _orders(tmp_path, "reverse") == [order[::-1] for order in usual]
    one, again, other = (_orders(tmp_path, "random", seed) for seed in (1, 1, 2))
    assert one == again != other, "the seed says all"
    assert [sorted(order) for order in one] == usual
    assert one[-1] != one[-2] != usual[-2], "a launch after the other, each in another order"
    assert len(list((tmp_path / "cache").iterdir())) == 4, "kernels of another order are others"


def test_a_loop_of_warp_that_has_changed_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from warp._src import codegen, context

    monkeypatch.setattr(context, "runtime", None)
    monkeypatch.setattr(codegen, "cpu_module_template_forward", "for (int task = 0; ...)")
    with pytest.raises(RuntimeError, match="^task order: Warp .* loops over the tasks in another way"):
        orders.install("reverse", 1)


def test_an_order_is_not_chosen_too_late() -> None:
    import warp as wp

    wp.init()
    with pytest.raises(RuntimeError, match="before Warp starts"):
        orders.install("reverse", 1)
