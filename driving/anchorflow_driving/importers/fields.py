"""Read fields of JSON, pickle and XML files, with errors that name the file and the field."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.errors import LogError

NAMES = ("token", "id")
"""Keys by which an entry of a list is called, before its index."""


class Located:
    """A part of a file, known by the file's path and the field's name."""

    def __init__(self, path: Path, field: str) -> None:
        self.path, self.field = path, field

    def refuse(self, expected: str, found: object, *, within: str = "") -> LogError:
        """Return the error that names the file and this field, or the one `within`."""
        field = self._inner(within) if within else self.field
        return LogError(self.path, field or "root", expected=expected, found=str(found))

    def _inner(self, key: str) -> str:
        return f"{self.field}.{key}" if self.field else key


class Entry(Located):
    """A value of a JSON or pickle file, with its name."""

    def __init__(self, path: Path, field: str, value: Any) -> None:
        super().__init__(path, field)
        self.value = value

    @classmethod
    def of_json(cls, path: Path) -> Entry:
        """The root. Raises `LogError` if the file cannot be read, or is no JSON."""
        try:
            return cls(path, "", json.loads(path.read_bytes()))
        except (OSError, ValueError, RecursionError) as error:
            raise LogError(path, "file", expected="a JSON file", found=str(error)) from error

    def __getitem__(self, key: str) -> Entry:
        found = self.maybe(key)
        if found is None:
            raise self.refuse("the field", "none", within=key)
        return found

    def maybe(self, key: str) -> Entry | None:
        """None where the key is missing or null."""
        value = self._mapping().get(key)
        return None if value is None else Entry(self.path, self._inner(key), value)

    def values(self) -> Iterator[Entry]:
        """Iterate over the values of a mapping."""
        for key, value in self._mapping().items():
            yield Entry(self.path, self._inner(str(key)), value)

    def __iter__(self) -> Iterator[Entry]:
        """Iterate over a list."""
        if not isinstance(self.value, (list, tuple)):
            raise self.refuse("a list", _kind(self.value))
        for index, value in enumerate(self.value):
            yield Entry(self.path, f"{self.field}[{_name(value, index)}]", value)

    @property
    def text(self) -> str:
        if not isinstance(self.value, (str, int)) or isinstance(self.value, bool):
            raise self.refuse("a text", _kind(self.value))
        return str(self.value)

    @property
    def texts(self) -> list[str]:
        return [each.text for each in self]

    @property
    def flag(self) -> bool:
        if not isinstance(self.value, (bool, np.bool_)):
            raise self.refuse("true or false", _kind(self.value))
        return bool(self.value)

    @property
    def number(self) -> float:
        return float(self.numbers())

    def numbers(self, *shape: int | None) -> NDArray[np.float64]:
        """An array of this shape, None for any size.

        Raises `LogError` if it is of another shape, or not all finite numbers.
        """
        expected = f"finite numbers [{', '.join('n' if n is None else str(n) for n in shape)}]"
        try:
            array = np.asarray(self.value)
        except ValueError as error:  # lists of several lengths
            raise self.refuse(expected, error) from error
        if not array.size and None in shape:
            array = np.zeros([n or 0 for n in shape])
        fits = array.ndim == len(shape) and all(
            n in (None, size) for n, size in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype.kind not in "iuf":
            raise self.refuse(expected, f"{array.dtype} {list(array.shape)}")
        if not np.isfinite(array).all():
            raise self.refuse(expected, "NaN or infinity")
        return array.astype(np.float64)

    def _mapping(self) -> Mapping[Any, Any]:
        if not isinstance(self.value, Mapping):
            raise self.refuse("a mapping", _kind(self.value))
        return self.value


def chosen_scene(root: Entry, names: Sequence[str], name: str | None, *, within: str) -> str:
    """Return the scene of that name, or the only one.

    Raises `LogError` if there is no such scene, or none was named and there are several.
    """
    if name is None and len(names) == 1:
        return names[0]
    if name is None or name not in names:
        told = ", ".join([*names[:20], *(["…"] if len(names) > 20 else [])])
        raise root.refuse(f"one of {told}", name or "no name (--scene)", within=within)
    return name


def by_token(entries: Entry) -> dict[str, Entry]:
    """The entries of a list by their tokens."""
    return {entry["token"].text: entry for entry in entries}


def _name(value: Any, index: int) -> object:
    if isinstance(value, Mapping):
        return next((value[name] for name in NAMES if name in value), index)
    return index


def _kind(value: Any) -> str:
    return type(value).__name__


class Element(Located):
    """An element of an XML file, with its name."""

    def __init__(self, path: Path, field: str, node: ElementTree.Element) -> None:
        super().__init__(path, field)
        self._node = node

    @classmethod
    def of_file(cls, path: Path, tag: str) -> Element:
        """The root.

        Raises `LogError` if the file cannot be read, is no XML, or has another root.
        """
        try:
            root = ElementTree.parse(path).getroot()
        except (OSError, ElementTree.ParseError) as error:
            raise LogError(path, "file", expected="an XML file", found=str(error)) from error
        if root.tag != tag:
            raise LogError(path, "root element", expected=tag, found=root.tag)
        return cls(path, tag, root)

    def attribute(self, name: str) -> str:
        if name not in self._node.attrib:
            raise self.refuse("the attribute", "none", within=name)
        return self._node.attrib[name]

    def children(self, tag: str) -> Iterator[Element]:
        for index, node in enumerate(self._node.findall(tag)):
            name = node.attrib.get("id", node.attrib.get("ref", str(index)))
            yield Element(self.path, self._inner(f"{tag}[{name}]"), node)

    def child(self, tag: str) -> Element:
        found = self.maybe(tag)
        if found is None:
            raise self.refuse("the element", "none", within=tag)
        return found

    def maybe(self, tag: str) -> Element | None:
        node = self._node.find(tag)
        return None if node is None else Element(self.path, self._inner(tag), node)

    @property
    def text(self) -> str:
        return (self._node.text or "").strip()

    def number(self, tag: str) -> float:
        """Return a child's number: its text, its `exact`, or the middle of its interval."""
        child = self.child(tag)
        if child.maybe("exact") is not None:
            return child.number("exact")
        if child.maybe("intervalStart") is not None:
            return (child.number("intervalStart") + child.number("intervalEnd")) / 2
        return as_number(child.text, child)


def as_number(text: str, where: Element) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise where.refuse("a finite number", repr(text))
    return value
