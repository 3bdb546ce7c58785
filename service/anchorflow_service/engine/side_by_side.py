"""Tasks of one request, done by the thread that asks and by others beside it."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class Helpers:
    """Threads that stand by for the tasks of requests, and end with this.

    A task of theirs begins and is waited for in a third of the time that an executor's takes, which
    tells in requests of a few milliseconds.

    count: of threads, which begin when they are first needed
    """

    def __init__(self, count: int, *, name: str) -> None:
        self._count, self._name = count, name
        self._tasks: SimpleQueue[_Task[Any] | None] = SimpleQueue()
        self._beginning, self._has_begun = Lock(), False

    def side_by_side(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """What the tasks return; the first is done by the caller, the others beside it.

        It comes back once all have ended: one that is left behind would keep a core busy unseen.

        Raises:
            Exception: what the first of the tasks raises that does.
        """
        others = [_Task(task) for task in tasks[1:]]
        if others:
            self._begin()
        for other in others:
            self._tasks.put(other)
        try:
            own = tasks[0]()
        finally:
            for other in others:
                other.wait()
        return [own, *(other.result() for other in others)]

    def _begin(self) -> None:
        with self._beginning:
            if self._has_begun:
                return
            self._has_begun = True
            for number in range(self._count):
                name = f"{self._name}-{number}"
                Thread(target=_stand_by, args=(self._tasks,), name=name, daemon=True).start()
            weakref.finalize(self, _dismiss, self._tasks, self._count)


class _Task(Generic[Result]):
    """Something to do, and what became of it."""

    def __init__(self, work: Callable[[], Result]) -> None:
        self._work = work
        self._ended = Lock()
        self._ended.acquire()
        self._fault: BaseException | None = None

    def do(self) -> None:
        try:
            self._result = self._work()
        except BaseException as fault:  # noqa: BLE001 - it is raised where it is waited for
            self._fault = fault
        finally:
            self._ended.release()

    def wait(self) -> None:
        self._ended.acquire()

    def result(self) -> Result:
        if self._fault is not None:
            raise self._fault
        return self._result


def _stand_by(tasks: SimpleQueue[_Task[Any] | None]) -> None:
    while (task := tasks.get()) is not None:
        task.do()
        del task  # nothing of a request is kept until the next


def _dismiss(tasks: SimpleQueue[_Task[Any] | None], count: int) -> None:
    for _ in range(count):
        tasks.put(None)
