"""An arm file as YAML text: its nodes, their lines, and what no arm file may be, whatever it says.

Places are tuples such as `("joints", 2, "ratio")`, written `joints[2].ratio` for people.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import yaml

from config.errors import ConfigError
from config.yaml_syntax import syntax_error

Location = tuple[str | int, ...]

MOST_ENTRIES = 10_000
DEEPEST = 20
LIBYAML: type[yaml.SafeLoader] | None = getattr(yaml, "CSafeLoader", None)
"""libyaml's loader, nine times as fast as PyYAML's own; not everywhere is it part of PyYAML."""
COMMENT = re.compile(r"(?:^| )#[^\r\n\x85\u2028\u2029]*", re.MULTILINE)
READ_DIFFERENTLY = re.compile(r"[\t?&*!|>%@`\\\ufeff\x7f-\x9f\u2028\u2029]|\r(?!\n)")
"""What libyaml takes in places where PyYAML does not, reads as something else, or has other words for."""
UNREADABLE = (yaml.YAMLError, ValueError, IndexError, KeyError, AttributeError, TypeError)
"""What PyYAML raises at a scalar that is none of the kind its tag says, besides what it should."""


def parse(text: str, file: str) -> tuple[yaml.Node, dict[str, Any]]:
    """The nodes of an arm file and what they say; raises ConfigError."""
    try:
        loader = _loader(text)
        try:
            root = loader.get_single_node()
            if root is None:
                raise ConfigError(
                    "the file is empty; an arm file needs name, control, bus and joints: start from a copy "
                    "of episode1.yaml.",
                    file=file,
                )
            _refuse_duplicates(root, file, set())
            _refuse_floods(root, file)
            values = loader.construct_document(root)
            if not isinstance(values, dict):
                raise ConfigError(
                    "the file is not a list of fields; an arm file begins with lines such as `name: my_arm`: "
                    "start from a copy of episode1.yaml.",
                    file=file,
                    line=_line(root),
                )
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        raise syntax_error(error, text, file) from None
    except UNREADABLE as error:
        # A forbidden character, or a scalar that looks like a date and is none.
        raise ConfigError(
            f"this is not valid YAML ({' '.join(str(error).split())}); correct the file.", file=file
        ) from None
    except RecursionError:
        raise ConfigError(
            "the file is nested too deeply; an arm file has four levels at most: correct its brackets.",
            file=file,
        ) from None
    return root, values


def _loader(text: str) -> yaml.SafeLoader:
    """libyaml's, for a text that both read alike; PyYAML's own for all others, and for its words of what is wrong."""
    with suppress(*UNREADABLE):
        if LIBYAML and not READ_DIFFERENTLY.search(COMMENT.sub("", text)) and is_flat(text, LIBYAML, DEEPEST):
            return LIBYAML(text)
    return yaml.SafeLoader(text)


def is_flat(text: str, loader: type, deepest: int, *, aliases: bool = True) -> bool:
    """Whether a YAML text is nested no deeper than this, and has no alias where there must be none.

    At a deeper one libyaml's composer, which calls itself, ends the process; its parser, which looks here, does not.
    Raises what the parser does, at a text that is no YAML.
    """
    depth = 0
    for event in yaml.parse(text, loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > deepest or (isinstance(event, yaml.AliasEvent) and not aliases):
            return False
    return True


def _refuse_duplicates(node: yaml.Node, file: str, seen: set[int]) -> None:
    """YAML lets a later key silently replace an earlier one; an arm file must not."""
    if id(node) in seen:  # an alias: the same node again, or a loop
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_duplicates(item, file, seen)
    elif isinstance(node, yaml.MappingNode):
        first: dict[str, int] = {}
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in first:
                    raise ConfigError(
                        f"{key.value} is given twice, here and on line {first[key.value]}; each field may be "
                        "given once: remove one.",
                        file=file,
                        line=_line(key),
                    )
                first[key.value] = _line(key)
            _refuse_duplicates(value, file, seen)


def _refuse_floods(root: yaml.Node, file: str | None) -> None:
    """A few lines of aliases and merged keys can stand for more than a memory holds, once somebody writes them out."""
    counted: dict[int, int] = {}

    def entries(node: yaml.Node) -> int:
        """Fields, items and values inside, those that an alias repeats counted each time."""
        if id(node) in counted:
            if not counted[id(node)]:
                raise ConfigError("an alias contains itself; write out what is meant.", file=file, line=_line(node))
            return counted[id(node)]
        counted[id(node)] = 0
        inside: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            inside = node.value
        elif isinstance(node, yaml.MappingNode):
            inside = [part for pair in node.value for part in pair]
        count = 1
        for part in inside:
            count += entries(part)
            if count > MOST_ENTRIES:
                raise ConfigError(
                    f"written out, with its aliases and merged keys, this has more than {MOST_ENTRIES} entries, "
                    "which no arm needs; shorten it.",
                    file=file,
                    line=_line(node),
                )
        counted[id(node)] = count
        return count

    entries(root)


def _line(node: yaml.Node) -> int:
    mark = node.start_mark
    return int(mark.line) + 1


def _children(node: yaml.Node | None) -> Iterator[tuple[str | int, int, yaml.Node]]:
    """Name or index, line and node of what is directly inside; merged keys come first and may be hidden."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield key.value, _line(key), value
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield index, _line(item), item


def lines(node: yaml.Node, above: Location) -> Iterator[tuple[str, int]]:
    """Every location and its line; only for a file the schema accepted, whose nesting is therefore small."""
    for name, line, child in _children(node):
        here = (*above, name)
        yield text_of(here), line
        yield from lines(child, here)


def find_line(root: yaml.Node, location: Location) -> int:
    """The line of a location, or of the innermost enclosing one that stands in the file."""
    node: yaml.Node | None = root
    line = _line(root)
    for part in location:
        found = [(at, child) for name, at, child in _children(node) if name == part]
        if not found:
            break
        line, node = found[-1]
    return line


def value_of(text: str) -> Any:
    """What a YAML text says, other than a flood; raises what PyYAML does, or ConfigError."""
    loader = _loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        _refuse_floods(node, None)
        return loader.construct_document(node)
    finally:
        loader.dispose()


def text_of(location: Location) -> str:
    """`("joints", 2, "ratio")` as `joints[2].ratio`."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def parts_of(text: str) -> Location:
    """`joints[2].ratio` as `("joints", 2, "ratio")`."""
    return tuple(
        int(index) if index else name for name, index in re.findall(r"([^.\[\]]+)(?![^\[]*\])|\[(\d+)\]", text)
    )
