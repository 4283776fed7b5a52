"""The documentation site: it builds without a warning, asks no other machine for anything, and links hold."""

import fcntl
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


class Resources(HTMLParser):
    """Addresses that a browser loads by itself, anchors, and what links lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        self.anchors |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        elif tag == "link" and values.get("rel") not in ("canonical", "prev", "next"):
            self.loaded.append(values.get("href", ""))
        self.loaded += [values["src"]] if "src" in values else []


def read(page: Path) -> Resources:
    found = Resources()
    found.feed(page.read_text())
    return found


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built once for all workers of a run."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "site"
    with (folder.parent / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "built").exists():
            build(folder)
            (folder / "built").touch()
    return folder


def build(folder: Path) -> None:
    result = subprocess.run(
        [str(Path(sys.executable).with_name("mkdocs")), "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "WARNING" not in result.stderr


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    pages = list(site.glob("*.html"))
    assert len(pages) > 10
    for page in pages:
        for address in read(page).loaded:
            assert "//" not in address, f"{page.name} loads {address}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\((?!data:)[\"']?https?:|@import", sheet.read_text()), sheet


def test_links_of_the_site_lead_to_its_pages_and_anchors(site: Path) -> None:
    pages = {page: read(page) for page in site.glob("*.html") if page.name != "404.html"}
    for page, found in pages.items():
        for link in found.links:
            if "://" in link or link.startswith("mailto:"):
                continue
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name and name != "." else page
            target = target / "index.html" if target.is_dir() else target
            assert target.exists(), f"{page.name} links to {link}"
            if anchor and target in pages:
                assert anchor in pages[target].anchors, f"{page.name} links to {link}"


def test_every_numbered_equation_is_mathml_with_its_number_as_anchor(site: Path) -> None:
    numbers = re.findall(r"\\tag\{(M\d+)\}", (ROOT / "docs" / "method.md").read_text())
    method = (site / "method.html").read_text()
    assert len(numbers) > 15
    assert set(numbers) <= read(site / "method.html").anchors
    assert method.count("<math") >= len(numbers)
    assert "$$" not in method
    assert "\\" not in re.sub(r"<[^>]*>", "", "".join(re.findall(r"<math.*?</math>", method, re.DOTALL)))


def test_the_reference_describes_every_public_name(site: Path) -> None:
    import truewrench as tw

    described = {
        anchor.split(".")[-1] for anchor in read(site / "api.html").anchors if "truewrench." in anchor
    }
    assert set(tw.__all__) - {"__version__", "TruewrenchError"} <= described
