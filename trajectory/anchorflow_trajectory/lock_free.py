"""Attributes that are worked out when they are first asked for, without a lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

Value = TypeVar("Value")


class cached_property(Generic[Value]):  # noqa: N801 - it stands in for that of functools
    """What `functools.cached_property` is from Python 3.12 on.

    Before, it holds one lock for the attribute of all instances while it works one of them out:
    threads that plan on different scenes would wait for each other. Threads that ask the same
    instance at once may work it out more than once, to the same.
    """

    def __init__(self, work_out: Callable[[Any], Value]) -> None:
        self._work_out = work_out
        self.__doc__ = work_out.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> cached_property[Value]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: object | None, owner: type) -> Value | cached_property[Value]:
        if instance is None:
            return self
        # From now on found before this descriptor, which does not say how to set it.
        value = instance.__dict__[self._name] = self._work_out(instance)
        return value
