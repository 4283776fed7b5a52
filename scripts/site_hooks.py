"""What mkdocs does beside rendering docs/: pages from the repository's root, and equations as MathML.

README's "Five minutes" is the quick start, and CONTRIBUTING and CHANGELOG are pages of their own, so that
nothing is written twice. Links of docs/ to other files of the repository lead to copies of them.
"""

from __future__ import annotations

import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
ORDER = (
    "index",
    "quickstart",
    "tutorial",
    "report",
    "troubleshooting",
    "notation",
    "method",
    "formats",
    "robots",
)
LAST = ("results", "api", "contributing", "changelog")
PAGES = {"README.md": "quickstart.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}

_LINK = re.compile(r"(\]\()([^)\s#]+)(#[^)\s]*)?\)")
_EQUATION = re.compile(r"^\$\$(.*?)\$\$$", re.MULTILINE | re.DOTALL)
_STYLE = (
    "display: flex; align-items: center; justify-content: space-between; margin: 1em 0; "
    "overflow: auto hidden; padding: .3em 0"
)
_TAG = re.compile(r"\\tag\{([^}]*)\}")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The order of the pages; new ones stand between how things are used and what they came to."""
    names = {page.stem for page in (ROOT / "docs").glob("*.md")} | {
        Path(page).stem for page in PAGES.values()
    }
    between = sorted(names - {*ORDER, *LAST})
    config.nav = [f"{name}.md" for name in (*ORDER, *between, *LAST) if name in names]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from the root and the files that pages link to."""
    linked: set[Path] = set()
    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        if name == "README.md":
            text = _quick_start(text)
        files.append(File.generated(config, page, content=_relinked(text, ROOT, linked)))
    for file in files.documentation_pages():
        if file.abs_src_path is not None:
            _relinked(Path(file.abs_src_path).read_text(encoding="utf-8"), ROOT / "docs", linked)
    for path in sorted(linked):
        files.append(File.generated(config, _copy(path), content=path.read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links out of docs/ to where these files are on the site, and turn equations into MathML."""
    if page.file.abs_src_path is not None:
        markdown = _relinked(markdown, ROOT / "docs", set())
    return _EQUATION.sub(lambda match: _mathml(match.group(1)), markdown)


def _quick_start(readme: str) -> str:
    sections = re.split(r"^(?=## )", readme, flags=re.MULTILINE)
    chosen = [text for text in sections if text.startswith(("## Two commands", "## Five minutes"))]
    return "# Quick start\n\n" + "".join(chosen)


def _relinked(text: str, folder: Path, linked: set[Path]) -> str:
    """Links as they are on the site; files outside docs/ that they lead to are added to `linked`."""

    def moved(match: re.Match[str]) -> str:
        before, target, anchor = match.group(1), match.group(2), match.group(3) or ""
        if "://" in target:
            return match.group()
        path = (folder / target).resolve()
        if path.is_relative_to(ROOT / "docs"):
            return f"{before}{path.relative_to(ROOT / 'docs')}{anchor})"
        name = str(path.relative_to(ROOT))
        if name in PAGES:
            return f"{before}{PAGES[name]}{anchor})"
        linked.add(path)
        return f"{before}{_copy(path)}{anchor})"

    return _LINK.sub(moved, text)


def _copy(path: Path) -> str:
    name = path.relative_to(ROOT).as_posix()
    return f"files/{name}" if path.suffix else f"files/{name}.txt"


def _mathml(latex: str) -> str:
    """A display equation with its number as an anchor; what the converter does not know is put otherwise."""
    tag = _TAG.search(latex)
    latex = _TAG.sub("", latex).strip()
    latex = re.sub(r"\\[bB]ig+[lr]?(?=\\\|)", "", latex)
    latex = re.sub(r"(\\begin\{bmatrix\}|\\\\)\s*\[", r"\1 {}[", latex)  # no optional argument
    number = f'<span class="number">({tag.group(1)})</span>' if tag else ""
    anchor = f' id="{tag.group(1)}"' if tag else ""
    math = convert(latex, display="block").replace("\n", " ")
    return f'\n<div class="equation"{anchor} style="{_STYLE}">{math}{number}</div>\n'
