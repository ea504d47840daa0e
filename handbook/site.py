"""A hook of MkDocs: the site is made from `build/docs`, which holds `docs/` and what its pages lead to outside of it.

On GitHub a page may lead to any file of the repository. A site has only its own pages; so the README becomes its
entry, CONTRIBUTING and CHANGELOG become pages, and every other file or folder that a page leads to is shown on a page
of its own below `source/`. Links are rewritten on the way; one that leads nowhere stays as it is, and MkDocs
complains of it.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from handbook.links import leads_elsewhere, targets, with_targets

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

PAGES_OUTSIDE = {
    "README.md": "index.md",
    "README.zh-CN.md": "index.zh.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages of the repository that stand outside docs/, and their place in the site."""
LANGUAGE_LINE = re.compile(r"^(English|\[English\]\(\S+\)) \| .*\n\n", re.MULTILINE)
"""Leads to a page in the other language; the site has a switch for that."""
LANGUAGES = {".py": "python", ".yaml": "yaml", ".json": "json", ".toml": "toml", ".sh": "bash", ".action": "text"}
ENGLISH_BOOST = 4
GENERATED = {"__pycache__", ".git", ".venv", "build", "dist"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Assemble the tree and let MkDocs take it for its docs folder; called once for each language."""
    root = Path(config.config_file_path).parent
    config.docs_dir = str(root / "build" / "docs")
    assemble(root, Path(config.docs_dir))
    config.nav = [with_folders(entry, Path(config.docs_dir)) for entry in config.nav or []]
    return config


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Let English pages come first in a search, as one index serves both languages; Chinese words find Chinese ones."""
    if not page.file.src_uri.endswith(".zh.md"):
        page.meta.setdefault("search", {}).setdefault("boost", ENGLISH_BOOST)
    return markdown


def with_folders(entry: Any, tree: Path) -> Any:
    """An entry of the navigation, in which `FOLDER/*` stands for the pages of a folder, its index first."""
    if isinstance(entry, dict):
        return {title: with_folders(below, tree) for title, below in entry.items()}
    if isinstance(entry, str) and entry.endswith("/*"):
        names = {path.name for path in (tree / entry[:-2]).glob("*.md") if not path.name.endswith(".zh.md")}
        return [f"{entry[:-1]}{name}" for name in sorted(names, key=lambda name: (name != "index.md", name))]
    if isinstance(entry, list):
        return [with_folders(below, tree) for below in entry]
    return entry


def assemble(root: Path, tree: Path) -> None:
    """Make the tree of pages anew from a repository."""
    texts = pages(root)
    places = {source: place_of(source) for source in texts}
    led_to = sorted({found for source, text in texts.items() for found in sources_led_to(root, source, text)})
    while led_to:  # folders lead to their files
        for source in led_to:
            texts[source], places[source] = source_page(root, source), source_place(source)
        led_to = sorted({f for s in led_to for f in sources_led_to(root, s, texts[s])} - places.keys())
    wanted = {places[source]: rewritten(source, text, places) for source, text in texts.items()}
    pictures = {
        path.relative_to(root / "docs").as_posix(): path.read_bytes()
        for path in (root / "docs").rglob("*")
        if path.is_file() and path.suffix != ".md"
    }
    write_tree(tree, {**{place: text.encode() for place, text in wanted.items()}, **pictures})


def pages(root: Path) -> dict[str, str]:
    """The text of each page of the repository, by its path."""
    paths = [*(root / "docs").rglob("*.md"), *(path for name in PAGES_OUTSIDE if (path := root / name).exists())]
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in sorted(paths)}


def place_of(source: str) -> str:
    """Where a page of the repository stands in the site."""
    return PAGES_OUTSIDE.get(source) or PurePosixPath(source).relative_to("docs").as_posix()


def source_place(source: str) -> str:
    """Where a file or folder is shown; without dots, since MkDocs would take the last part for a language."""
    return f"source/{source.replace('.', '_')}.md"


def resolved(source: str, target: str) -> tuple[str, str]:
    """The path in the repository that a link on a page leads to, and the anchor with its #."""
    path, mark, anchor = target.partition("#")
    there = os.path.normpath(PurePosixPath(source).parent / path) if path else source
    return there, mark + anchor


def sources_led_to(root: Path, source: str, text: str) -> set[str]:
    """Files and folders of the repository, none of them a page of the site, that a page leads to."""
    there = {resolved(source, target)[0] for target in targets(text) if not leads_elsewhere(target)}
    return {
        path
        for path in there
        if not path.startswith(("..", "/", "docs/")) and path not in PAGES_OUTSIDE and (root / path).exists()
    }


def source_page(root: Path, source: str) -> str:
    """A page that shows a file, or names the files of a folder."""
    path = root / source
    head = f"---\nsearch:\n  exclude: true\n---\n\n# {source}\n\n"
    if path.is_file():
        fence = "`" * 6
        text = path.read_text(encoding="utf-8").rstrip("\n")
        return f"{head}{fence}{LANGUAGES.get(path.suffix, 'text')}\n{text}\n{fence}\n"
    files = sorted(
        found.relative_to(path.parent).as_posix()
        for found in path.rglob("*")
        if found.is_file() and not GENERATED & set(found.relative_to(root).parts)
    )
    return head + "\n".join(f"- [{name}]({name})" for name in files) + "\n"


def rewritten(source: str, text: str, places: Mapping[str, str]) -> str:
    """A page with its links as they are in the site."""
    here = PurePosixPath(places[source]).parent

    def in_site(target: str) -> str:
        if leads_elsewhere(target) or target.startswith("#"):
            return target
        there, anchor = resolved(source, target)
        place = places.get(there) or (there.removeprefix("docs/") if there.startswith("docs/") else None)
        return target if place is None else os.path.relpath(place, here) + anchor

    return with_targets(LANGUAGE_LINE.sub("", text), in_site)


def write_tree(tree: Path, files: Mapping[str, bytes]) -> None:
    """Make a folder hold exactly these files; those that are the same already are not touched."""
    for place, content in files.items():
        path = tree / place
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_bytes() != content:
            path.write_bytes(content)
    for path in tree.rglob("*"):
        if path.is_file() and path.relative_to(tree).as_posix() not in files:
            path.unlink()
    for path in sorted(tree.rglob("*"), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            shutil.rmtree(path)
