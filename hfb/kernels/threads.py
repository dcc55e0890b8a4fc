"""Worker threads for compiled kernels, which release Python's lock.

Numba's own threads are not used: the default layer aborts the process when several Python threads use it, another kills
a forked child. A child of fork() starts without workers (threads do not survive a fork) and makes its own.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from typing import TypeVar

Result = TypeVar("Result")

_pools: dict[int, ThreadPoolExecutor] = {}
_lock = threading.Lock()


def _forget_pools() -> None:
    global _lock
    _lock = threading.Lock()
    _pools.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pools)


def _pool(workers: int) -> ThreadPoolExecutor:
    with _lock:
        if workers not in _pools:
            _pools[workers] = ThreadPoolExecutor(workers, thread_name_prefix="hfb-render")
        return _pools[workers]


def run_tasks(task: Callable[[int], Result], tasks: int, threads: int) -> list[Result]:
    """Return [task(0), ..., task(tasks - 1)], run by the calling thread and at most `threads` - 1 others.

    Safe from several threads at once: the caller runs its own tasks, helped by free workers.

    Args:
        task: called with its number.
        tasks: number of tasks.
        threads: most threads.
    """
    if threads <= 1 or tasks <= 1:
        return [task(i) for i in range(tasks)]
    results: dict[int, Result] = {}
    following = count()

    def work() -> None:
        while (i := next(following)) < tasks:
            results[i] = task(i)

    workers = min(threads, tasks) - 1
    pool = _pool(threads - 1)
    helpers = [pool.submit(work) for _ in range(workers)]
    try:
        work()
    finally:
        for helper in helpers:
            if not helper.cancel():
                helper.result()
    return [results[i] for i in range(tasks)]
