"""A thread pool for the tasks of one request, which run on the calling thread and beside it."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class ThreadPool:
    """Threads that wait for tasks, and end when the pool is collected.

    A task starts and is joined in a third of the time that an executor takes, which matters for
    requests of a few milliseconds.

    count: number of threads, which start when they are first needed
    """

    def __init__(self, count: int, *, name: str) -> None:
        self._count, self._name = count, name
        self._tasks: SimpleQueue[_Task[Any] | None] = SimpleQueue()
        self._starting, self._has_started = Lock(), False

    def run(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """Return what the tasks return. The first runs on the calling thread, the others beside it.

        Returns when all tasks have ended: one that was left behind would keep a core busy. Raises
        what the first failing one raises.
        """
        others = [_Task(task) for task in tasks[1:]]
        if others:
            self._start()
        for other in others:
            self._tasks.put(other)
        try:
            own = tasks[0]()
        finally:
            for other in others:
                other.wait()
        return [own, *(other.result() for other in others)]

    def _start(self) -> None:
        with self._starting:
            if self._has_started:
                return
            self._has_started = True
            for number in range(self._count):
                name = f"{self._name}-{number}"
                Thread(target=_work, args=(self._tasks,), name=name, daemon=True).start()
            weakref.finalize(self, _dismiss, self._tasks, self._count)


class _Task(Generic[Result]):
    """A task and its result or exception."""

    def __init__(self, work: Callable[[], Result]) -> None:
        self._work = work
        self._ended = Lock()
        self._ended.acquire()
        self._fault: BaseException | None = None

    def run(self) -> None:
        try:
            self._result = self._work()
        except BaseException as fault:  # noqa: BLE001 - `result` raises it on the calling thread
            self._fault = fault
        finally:
            self._ended.release()

    def wait(self) -> None:
        self._ended.acquire()

    def result(self) -> Result:
        if self._fault is not None:
            raise self._fault
        return self._result


def _work(tasks: SimpleQueue[_Task[Any] | None]) -> None:
    while (task := tasks.get()) is not None:
        task.run()
        del task  # keep nothing of a request until the next one


def _dismiss(tasks: SimpleQueue[_Task[Any] | None], count: int) -> None:
    for _ in range(count):
        tasks.put(None)
