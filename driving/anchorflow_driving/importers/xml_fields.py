"""XML with errors that name the file and the field."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from anchorflow_driving.errors import LogError


class Element:
    """An element of a file, and where it stands in it."""

    def __init__(self, path: Path, field: str, node: ElementTree.Element) -> None:
        self.path, self.field, self._node = path, field, node

    @classmethod
    def of_file(cls, path: Path, tag: str) -> Element:
        """The root.

        Raises:
            LogError: the file cannot be read, is no XML, or has another root.
        """
        try:
            root = ElementTree.parse(path).getroot()
        except (OSError, ElementTree.ParseError) as error:
            raise LogError(path, "file", expected="an XML file", found=str(error)) from error
        if root.tag != tag:
            raise LogError(path, "root element", expected=tag, found=root.tag)
        return cls(path, tag, root)

    def refuse(self, expected: str, found: object, *, within: str = "") -> LogError:
        field = f"{self.field}.{within}" if within else self.field
        return LogError(self.path, field, expected=expected, found=str(found))

    def attribute(self, name: str) -> str:
        if name not in self._node.attrib:
            raise self.refuse("the attribute", "none", within=name)
        return self._node.attrib[name]

    def children(self, tag: str) -> Iterator[Element]:
        for index, node in enumerate(self._node.findall(tag)):
            name = node.attrib.get("id", node.attrib.get("ref", str(index)))
            yield Element(self.path, f"{self.field}.{tag}[{name}]", node)

    def child(self, tag: str) -> Element:
        found = self.maybe(tag)
        if found is None:
            raise self.refuse("the element", "none", within=tag)
        return found

    def maybe(self, tag: str) -> Element | None:
        node = self._node.find(tag)
        return None if node is None else Element(self.path, f"{self.field}.{tag}", node)

    @property
    def text(self) -> str:
        return (self._node.text or "").strip()

    def number(self, tag: str) -> float:
        """Of a child: its text, or that of `exact`, or the middle of an interval."""
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
