"""The documentation, and what it tells its readers to type."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


def fenced(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


BENCHMARKS = list(
    dict.fromkeys(
        line
        for page in PAGES
        for block in fenced(page, "sh")
        for line in block.splitlines()
        if line.startswith("python benchmarks/")
    )
)
