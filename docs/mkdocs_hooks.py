"""What MkDocs does for our pages besides its own: they are read on GitHub as well, and stay as they are.

    README.md and its neighbours     are pages of the site, with their links turned to it
    ../examples/agent.yaml           is handed out with the site; of source code only the name stands there
    reference/…                      is made from the code (docs/reference.py); reference.py#http links to it
    ```mermaid of a state machine    becomes a table: the site draws nothing with scripts from elsewhere

A link to what is not there ends the build: of pages MkDocs looks after that (--strict), of files this does.
"""

from __future__ import annotations

import html
import re
import runpy
from pathlib import Path
from posixpath import normpath, relpath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).parent
ROOT = DOCS.parent

BESIDE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "reporting.md",
}
"""Pages beside docs/, and what they are called on the site."""

LINK = re.compile(r"(?P<open>!?\[(?:[^\[\]]|\[[^\]]*\])*\])\((?P<to>[^)\s#]+)(?P<at>#[^)\s]*)?\)")
COMMENT = re.compile(r"<!-- .*? -->\n?")
DIAGRAM = re.compile(r"```mermaid\n(?P<text>.*?)```", re.DOTALL)
ARROW = re.compile(r"^ *(?P<before>\S+) --> (?P<after>\S+)(?: : (?P<on>.*))?$", re.MULTILINE)
NAMED = re.compile(r'^ *state "(?P<name>[^"]+)" as (?P<short>\S+)$', re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages beside docs/, the reference, and the files that pages link to."""
    pages = runpy.run_path(str(DOCS / "reference.py"))["pages"]
    for name, uri in BESIDE.items():
        files.append(File.generated(config, uri, content=(ROOT / name).read_text(encoding="utf-8")))
    for uri, text in pages().items():
        files.append(File.generated(config, uri, content=text))
    for path in sorted((ROOT / "examples").rglob("*")):
        if path.is_file() and path.suffix != ".py":  # programs are no part of the site
            uri = path.relative_to(ROOT).as_posix()
            files.append(File.generated(config, uri, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links of a page to the site, and its diagrams to tables; the reference is found after what
    explains.
    """
    uri = page.file.src_uri
    if uri.startswith("reference/"):
        page.meta["search"] = {"boost": 0.5}
    source = next((name for name, to in BESIDE.items() if to == uri), f"docs/{uri}")
    text = COMMENT.sub("", DIAGRAM.sub(lambda found: machine(found["text"]), markdown))
    return LINK.sub(lambda link: turned(link, source, uri), text)


def turned(link: re.Match[str], source: str, uri: str) -> str:
    """Return a link of the file `source` of the repository as it stands on the page `uri` of the site."""
    to = link["to"]
    if "://" in to or to.startswith(("mailto:", "/")) or uri.startswith("reference/"):
        return link[0]
    path = normpath(f"{Path(source).parent.as_posix()}/{to}")
    if not (ROOT / path).exists():
        raise PluginError(f"{source}: there is no {path} to link to")
    if (ROOT / path).is_dir() and (ROOT / path / "README.md").exists():
        path += "/README.md"
    on_site = BESIDE.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else None)
    if on_site is None and path.startswith("examples/") and not path.endswith(".py"):
        on_site = path
    if on_site is None:
        return link["open"].removeprefix("!")[1:-1]  # source code: its name is enough
    here, at = Path(uri).parent.as_posix(), link["at"] or ""
    if path == "docs/reference.py":
        on_site, at = f"reference/{at.removeprefix('#')}.md", ""
    return f"{link['open']}({relpath(on_site, here)}{at})"


def machine(text: str) -> str:
    """Return the table of a state machine that Mermaid would draw."""
    names: dict[str, str] = {found["short"]: found["name"] for found in NAMED.finditer(text)}

    def name(state: str, edge: str) -> str:
        return edge if state == "[*]" else html.escape(names.get(state, state))

    rows = ["| from | to | when |", "| --- | --- | --- |"]
    for arrow in ARROW.finditer(text):
        before, after = name(arrow["before"], "(begin)"), name(arrow["after"], "(end)")
        rows.append(f"| {before} | {after} | {arrow['on'] or ''} |")
    return "\n".join(rows) + "\n"


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Have the search work in a page that is opened as a file: docs/site.js says how."""
    base = "../" * page.url.count("/")
    return output.replace("<script ", f'<script src="{base}site.js"></script>\n<script ', 1)


def on_post_build(config: MkDocsConfig) -> None:
    """Write the index of the search as a script, too."""
    index = Path(config.site_dir) / "search" / "search_index.json"
    text = f"var __index = {index.read_text(encoding='utf-8')};\n"
    index.with_suffix(".js").write_text(text, encoding="utf-8")


def on_page_context(context: dict[str, Any], page: Page, config: MkDocsConfig, nav: Any) -> dict[str, Any]:
    """Leave out the link to edit a page: nobody knows where this copy of the repository is."""
    page.edit_url = None
    return context
