# SPDX-License-Identifier: Apache-2.0
"""Tasks of a launch in another order than 0, 1, 2, ...: what the CPU always does, and CUDA never promises.

Warp's CPU kernels are loops over the tasks. The loop stands in one private string of Warp's code generator, which is
replaced here, before any kernel is compiled. Kernels so compiled get a cache directory of their own: Warp's hash of a
module does not know of the loop. Processes that a test starts keep the usual order.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

_CALL = "{name}_cpu_kernel_forward<wp_linear_contiguous>(*dim, task_index, _wp_args);"
_LOOP = f"""    for (size_t task_index = 0; task_index < dim->size; ++task_index)
    {{{{
        {_CALL}
    }}}}
"""

_REVERSE = f"""    for (size_t task_index = dim->size; task_index-- > 0;)
    {{{{
        {_CALL}
    }}}}
"""

# Steps of a stride without a common divisor with the number of tasks meet each once. Stride and start are others in
# every launch, so any two tasks come now in this order, now in that.
_RANDOM = f"""    static unsigned long long launches = SEEDull << 32;
    unsigned long long mixed = ++launches * 0x9E3779B97F4A7C15ull;
    mixed = (mixed ^ (mixed >> 29)) * 0xBF58476D1CE4E5B9ull;
    mixed ^= mixed >> 32;
    const size_t tasks = dim->size;
    size_t stride = tasks ? 1 + mixed % tasks : 0;
    for (size_t a = tasks, b = 0; tasks; ++stride)
    {{{{
        for (a = tasks, b = stride; b;)
        {{{{
            const size_t rest = a % b;
            a = b;
            b = rest;
        }}}}
        if (a == 1)
            break;
    }}}}
    size_t task_index = tasks ? (mixed >> 20) % tasks : 0;
    for (size_t done = 0; done < tasks; ++done)
    {{{{
        {_CALL}
        task_index = (task_index + stride) % tasks;
    }}}}
"""

ORDERS = {"reverse": _REVERSE, "random": _RANDOM}


def install(order: str, seed: int) -> Path:
    """Compile every kernel of this process for the CPU with its tasks in ``order``, one of ``ORDERS``; ``seed`` chooses
    among the random ones. Returns the directory that keeps the compiled kernels.

    Raises:
        RuntimeError: Warp's loop is not what it was when this was written, or Warp has started already.
    """
    import warp as wp
    from warp._src import build, codegen, context

    if context.runtime is not None:
        raise RuntimeError("task order: expected to be chosen before Warp starts")
    if codegen.cpu_module_template_forward.count(_LOOP) != 1:
        raise RuntimeError(f"task order: Warp {wp.__version__} loops over the tasks in another way")
    loop = ORDERS[order].replace("SEED", str(seed))
    codegen.cpu_module_template_forward = codegen.cpu_module_template_forward.replace(_LOOP, loop)
    build.init_kernel_cache()
    digest = hashlib.sha256(loop.encode()).hexdigest()[:8]
    build.init_kernel_cache(str(Path(wp.config.kernel_cache_dir).parent / f"tasks_{order}_{digest}"))
    return Path(wp.config.kernel_cache_dir)
