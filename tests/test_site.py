"""The documents become a site: every link leads somewhere, and nothing is fetched from a network."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(name="site", scope="module")
def site_fixture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it; `--strict` fails for a link or an anchor that leads nowhere."""
    site = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(site)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    return site


def pages(site: Path) -> Iterator[tuple[Path, str]]:
    for page in sorted(site.rglob("*.html")):
        yield page, page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_every_document_is_a_page_that_the_menu_leads_to(site: Path) -> None:
    menu = (site / "index.html").read_text(encoding="utf-8")
    for document in (ROOT / "docs").glob("*.md"):
        assert f'href="{document.stem}.html"' in menu, document.name


@pytest.mark.slow
def test_pages_fetch_nothing_from_a_network(site: Path) -> None:
    for page, text in pages(site):
        fetched = re.findall(r'<(?:script|img|iframe|link[^>]*stylesheet)[^>]*(?:src|href)="(?:https?:)?//[^"]*', text)
        assert not fetched, page


@pytest.mark.slow
def test_formulas_are_shown_without_a_script(site: Path) -> None:
    text = (site / "estimation.html").read_text(encoding="utf-8")
    assert text.count("<math") > 20
    assert "arithmatex" not in text


@pytest.mark.slow
def test_the_reference_is_made_of_docstrings(site: Path) -> None:
    text = (site / "api.html").read_text(encoding="utf-8")
    assert "smoother.api.smooth" in text
    assert "one standard deviation" in text.lower()
    assert not re.search(r":(func|class|mod):", text)


@pytest.mark.slow
def test_a_problem_code_is_found_by_the_search(site: Path) -> None:
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    assert any("gps_settling" in entry["title"] for entry in index["docs"])
