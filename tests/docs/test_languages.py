"""A Chinese page has what its English one has: headings, commands, tables, code words, links.

Words are the translator's; what is compared stands in `differences`, and CONTRIBUTING.md tells people of it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

import pytest
import yaml
from pages import DOCS, ROOT, Block, Section, all_pages, code_words, name_of, sections

from handbook.links import anchors, leads_elsewhere, slug, targets

COMMENT = re.compile(r"(?:^|(?<=\s))#(?!!).*$")
PICTURE_MARKS = set("┌└▼▲")
TRANSLATED_SECTIONS = ("Start", "Guides", "Hardware")
"""The parts of the site's navigation of which every page has a Chinese twin."""


def twin_of(page: Path) -> Path:
    """Where a page's Chinese twin stands, or would stand."""
    return ROOT / "README.zh-CN.md" if page == ROOT / "README.md" else page.with_suffix(".zh.md")


def english_of(page: Path) -> Path:
    """The page whose twin a Chinese one is."""
    return page.with_name(re.sub(r"\.zh(-CN)?\.md$", ".md", page.name))


TWINS = [page for page in all_pages() if re.search(r"\.zh(-CN)?\.md$", page.name)]


def wanted_target(english: Path, target: str) -> str | None:
    """The target that the Chinese page has for one of the English page; None for a link from a page to its twin."""
    if leads_elsewhere(target):
        return target
    path, mark, anchor = target.partition("#")
    if not path:
        return target
    there = Path(os.path.normpath(english.parent / path))
    if there in (twin_of(english), english):
        return None if not mark else mark + anchor
    if there.suffix == ".md" and twin_of(there).exists():
        path = os.path.relpath(twin_of(there), english.parent)
    return path + mark + anchor


def without_comments(block: Block) -> list[str]:
    """Its lines without what a translator may change; of a drawing that is everything."""
    if PICTURE_MARKS & set("".join(block.lines)):
        return [""] * len(block.lines)
    return [COMMENT.sub("#", line).rstrip() for line in block.lines]


def differences(english_page: Path, chinese_page: Path) -> Iterator[str]:
    """Where a Chinese page is not what its English one is, each with its place."""
    english = sections(english_page.read_text(encoding="utf-8"))
    chinese = sections(chinese_page.read_text(encoding="utf-8"))
    outline = [f"{'#' * part.level} {part.title}" for part in english]
    if [part.level for part in english] != [part.level for part in chinese]:
        theirs = [f"{'#' * part.level} {part.title}" for part in chinese]
        for ours, other in zip_longest(outline[1:], theirs[1:], fillvalue="nothing"):
            if ours.split(" ")[0] != other.split(" ")[0]:
                yield f"headings part at {ours!r}, where the twin has {other!r}"
                return
    for ours, theirs in zip(english, chinese, strict=True):
        place = f"{name_of(chinese_page)}:{theirs.line} (section {ours.title or 'before the first heading'!r})"
        for what in section_differences(english_page, ours, theirs):
            yield f"{place}: {what}"


def section_differences(page: Path, english: Section, chinese: Section) -> Iterator[str]:
    """Where a section's twin is not what it is."""
    wanted = sorted(there for target in english.targets if (there := wanted_target(page, target)) is not None)
    found = sorted(target for target in chinese.targets if wanted_target(page, target) is not None)
    if wanted != found:
        instead = sorted(set(found) - set(wanted)), sorted(set(wanted) - set(found))
        yield "links lead to {} instead of {}, ".format(*instead) + f"{len(found)} for {len(wanted)}"
    for mark in (r"[-*]", r"\d+\."):
        if english.items(mark) != chinese.items(mark):
            yield f"{chinese.items(mark)} items of lists ({mark}) for {english.items(mark)}"
    if english.code_words != chinese.code_words:
        missing, new = english.code_words - chinese.code_words, chinese.code_words - english.code_words
        yield f"in backticks: missing {sorted(missing)}, too many {sorted(new)}"
    yield from block_differences(english.blocks, chinese.blocks)
    yield from table_differences(english.tables, chinese.tables)


def block_differences(english: list[Block], chinese: list[Block]) -> Iterator[str]:
    if len(english) != len(chinese):
        yield f"{len(chinese)} fenced blocks for {len(english)}"
        return
    for ours, theirs in zip(english, chinese, strict=True):
        if ours.info != theirs.info:
            yield f"line {theirs.line}: the block is {theirs.info!r}, not {ours.info!r}"
        for line, other in zip_longest(without_comments(ours), without_comments(theirs)):
            if line != other:
                yield f"block at line {theirs.line} has {other!r} for {line!r}"


def table_differences(english: list[list[list[str]]], chinese: list[list[list[str]]]) -> Iterator[str]:
    if len(english) != len(chinese):
        yield f"{len(chinese)} tables for {len(english)}"
        return
    for ours, theirs in zip(english, chinese, strict=True):
        if len(ours) != len(theirs):
            yield f"a table has {len(theirs)} rows for {len(ours)}"
            continue
        for row, other in zip(ours, theirs, strict=True):
            if len(row) != len(other):
                yield f"row {other} has {len(other)} cells for {len(row)}"
            elif code_words(" ".join(row)) != code_words(" ".join(other)):
                yield f"row {other} has not the backticks of {row}"


def task_pages() -> list[Path]:
    """The pages of the site that are there in both languages."""

    class Loader(yaml.SafeLoader):
        """mkdocs.yml names a function, which is of no interest here."""

    Loader.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)
    navigation = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), Loader)["nav"]
    parts = [pages for part in navigation for name, pages in part.items() if name in TRANSLATED_SECTIONS]
    entries = [next(iter(e.values())) if isinstance(e, dict) else e for pages in parts for e in pages]
    return [ROOT / "README.md" if entry == "index.md" else DOCS / entry for entry in entries]


@pytest.mark.parametrize("page", task_pages(), ids=name_of)
def test_a_page_about_a_task_is_there_in_chinese(page: Path) -> None:
    assert page.exists()
    assert twin_of(page).exists(), f"{name_of(twin_of(page))} is missing"


@pytest.mark.parametrize("twin", TWINS, ids=name_of)
def test_a_chinese_page_is_in_step_with_the_english_one(twin: Path) -> None:
    english = english_of(twin)
    assert english.exists(), f"{name_of(twin)} has no English page"
    found = list(differences(english, twin))
    assert not found, "\n".join(found)


@pytest.mark.parametrize("twin", TWINS, ids=name_of)
def test_a_chinese_page_has_the_anchors_that_others_lead_to(twin: Path) -> None:
    english = english_of(twin)
    wanted = set()
    for page in all_pages():
        for target in targets(page.read_text(encoding="utf-8")):
            path, _, anchor = target.partition("#")
            there = Path(os.path.normpath(page.parent / path)) if path else page
            if anchor and there in (english, twin):
                wanted.add(anchor)
    missing = wanted - anchors(twin.read_text(encoding="utf-8"))
    assert not missing, f"{name_of(twin)} needs " + ", ".join(f'<a id="{anchor}"></a>' for anchor in sorted(missing))


ENGLISH = """# Title

Run `up`, see [b](b.md#coast).

```
rtarm up mock   # starts
```

## Coast

| a | b |
|---|---|
| `x|y` | 2 |

- one
"""
CHINESE = """# 标题

运行 `up`，见 [乙](b.md#coast)。

```
rtarm up mock   # 启动
```

<a id="coast"></a>

## 滑行

| 甲 | 乙 |
|---|---|
| `x|y` | 2 |

- 一
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("", "", ""),
        ("## 滑行", "### 滑行", "headings part"),
        ("rtarm up mock", "rtarm up", "has 'rtarm up   #' for 'rtarm up mock   #'"),
        ("   # 启动", "", "has 'rtarm up mock' for 'rtarm up mock   #'"),
        ("b.md#coast", "b.md", "links lead to ['b.md']"),
        ("`up`", "up", "missing ['up']"),
        ("| `x|y` | 2 |", "| `x|y` |", "1 cells for 2"),
        ("| `x|y` | 2 |\n", "", "1 rows for 2"),
        ("- 一", "", "0 items of lists"),
    ],
)
def test_what_is_compared(old: str, new: str, said: str, tmp_path: Path) -> None:
    """The comparison itself: one difference is found, and none where there is none."""
    english, chinese = (ROOT / "docs" / "a.md", ROOT / "docs" / "a.zh.md")
    ours = sections(ENGLISH)
    theirs = sections(CHINESE.replace(old, new) if old else CHINESE)
    if [part.level for part in ours] != [part.level for part in theirs]:
        assert said == "headings part"
        return
    found = [line for a, b in zip(ours, theirs, strict=True) for line in section_differences(english, a, b)]
    assert (len(found) > 0) == bool(said) and all(chinese.name not in line for line in found)
    assert said in "\n".join(found)


def test_anchors_are_githubs() -> None:
    assert slug("The flight recorder (`bench_recorder.py`)") == "the-flight-recorder-bench_recorderpy"
    assert anchors(CHINESE) == {"标题", "coast", "滑行"}
