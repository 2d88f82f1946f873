"""XML, read safely and written escaped."""

import math
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from droptrack.data.files import reading, replacing
from droptrack.errors import DroptrackError


def read_xml(path: Path) -> Element:
    """The root of a file. Raises DroptrackError for what is no XML, or has entities of its own."""
    try:
        from defusedxml.common import DefusedXmlException
        from defusedxml.ElementTree import parse
    except ImportError:
        raise DroptrackError("XML needs defusedxml: pip install 'droptrack[formats]'") from None
    try:
        with reading(path, "XML"):
            try:
                root = parse(path, forbid_dtd=True).getroot()
            except DefusedXmlException:
                raise DroptrackError(f"{path}: has a DTD, which is not read") from None
    except ElementTree.ParseError as error:
        raise DroptrackError(f"{path}: cannot be read as XML: {error}") from None
    if not isinstance(root, Element):
        raise DroptrackError(f"{path}: cannot be read as XML")
    return root


def write_xml(path: Path, root: Element) -> None:
    """Write a file, indented."""
    ElementTree.indent(root)
    with replacing(path) as partial:
        ElementTree.ElementTree(root).write(partial, encoding="UTF-8", xml_declaration=True)


def number(path: Path, element: Element, name: str) -> float:
    """An attribute as a number; raises DroptrackError where it is none."""
    try:
        value = float(element.attrib[name])
        if not math.isfinite(value):
            raise ValueError
    except (KeyError, ValueError):
        raise DroptrackError(
            f"{path}: <{element.tag}> should have a number {name}, not "
            f"{element.attrib.get(name, 'none')}"
        ) from None
    return value
