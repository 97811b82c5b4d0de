"""The documentation as a site: built as `make docs` builds it, then read as a browser reads it."""

import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import numpy as np
import pytest
from backends import backend_fault
from browser import open_browser, wait
from heavy import heavy
from PIL import Image
from snippets import REFERENCE, ROOT, referenced_names

from semisynth_gl.config import packaged_configs
from semisynth_gl.frame.channels import CHANNELS
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS

sys.path.insert(0, str(ROOT / "docs"))

import make_gallery

mkdocs = heavy("mkdocs")
pytestmark = pytest.mark.heavy

PAGES = [
    page
    for folder in ("docs", "examples", "benchmarks/results", "benchmarks/peers")
    for page in (ROOT / folder).glob("*.md")
]
MOST_BYTES_OF_PICTURES = 3_000_000

browser = pytest.fixture(scope="module")(open_browser)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    gallery, folder = tmp_path_factory.mktemp("gallery"), tmp_path_factory.mktemp("site") / "docs"
    make_gallery.main(gallery)
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=ROOT,
        # Whatever would be fetched ends at a port where nobody listens.
        env=os.environ
        | {"GALLERY": str(gallery), "ALL_PROXY": "http://127.0.0.1:9", "HTTPS_PROXY": "http://127.0.0.1:9"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


class Page(HTMLParser):
    """What a page loads, what it links to, and its anchors."""

    def __init__(self, path):
        super().__init__()
        self.path, self.loads, self.links, self.anchors, self.images = path, [], [], set(), []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.anchors |= {attributes[key] for key in ("id", "name") if attributes.get(key)}
        if tag == "a" and "href" in attributes:
            self.links.append(attributes["href"])
        elif tag == "link":
            self.loads.append(attributes["href"])
        elif attributes.get("src"):
            self.loads.append(attributes["src"])
        if tag == "img":
            self.images.append(attributes["src"])


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in site.rglob("*.html") if path.name != "404.html"}


def is_elsewhere(address):
    return re.match(r"[a-z]+:|//", address) is not None


def test_each_page_is_there(site, pages):
    sources = [page.relative_to(ROOT) for page in PAGES if page.parent == ROOT / "docs"]
    assert {site / f"{source.stem}.html" for source in sources} <= pages.keys()
    assert {site / "reference" / f"{page.stem}.html" for page in REFERENCE} <= pages.keys()


def test_links_lead_somewhere(pages):
    dead = []
    for path, page in pages.items():
        for address in (*page.links, *page.loads):
            target, anchor = urldefrag(unquote(address))
            if is_elsewhere(address):
                continue
            file = (path.parent / target).resolve() if target else path
            known = pages[file].anchors if file in pages else set()
            if not file.is_file() or (anchor and anchor not in known and not anchor.startswith("__")):
                dead.append(f"{path.name}: {address}")
    assert dead == []
    assert sum(len(page.links) for page in pages.values()) > 1000


def test_nothing_is_fetched_from_elsewhere(site, pages):
    assert [address for page in pages.values() for address in page.loads if is_elsewhere(address)] == []
    styles = [path.read_text("utf-8") for path in site.rglob("*.css")]
    assert [address for text in styles for address in re.findall(r"url\(['\"]?(http[^)]*|//[^)]*)\)", text)] == []
    # The theme fetches what it needs for these alone.
    assert not any(re.search(r'class="[^"]*\bmermaid\b', path.read_text("utf-8")) for path in pages)


def test_the_reference_has_every_public_name(site, pages):
    anchors = set[str]().union(*(page.anchors for path, page in pages.items() if path.parent == site / "reference"))
    assert set(referenced_names()) - anchors == set()


def test_the_gallery_shows_everything(site, pages):
    shown = {
        Path(source).relative_to("gallery").with_suffix("").as_posix() for source in pages[site / "gallery.html"].images
    }
    wanted = {f"configs/{name}" for name in packaged_configs()}
    wanted |= {f"models/{name}" for name in (*SIMPLE_KINDS, *COMPLEX_KINDS)}
    wanted |= {f"outputs/{name}" for name in CHANNELS}
    assert wanted <= shown
    settings = {key for key, values in make_gallery.IMPERFECTIONS.items() for _ in values}
    assert {re.sub(r"imperfections/\d+-", "", name) for name in shown if name.startswith("imp")} == {"none", *settings}


def test_pictures_are_small_and_none_is_blank(site):
    pictures = sorted((site / "gallery").rglob("*.jpg"))
    assert sum(path.stat().st_size for path in pictures) < MOST_BYTES_OF_PICTURES
    assert [path.name for path in pictures if np.ptp(np.asarray(Image.open(path).convert("L"))) < 100] == []


def test_variants_of_a_kind_differ(site):
    for path in sorted((site / "gallery" / "models").glob("*.jpg")):
        one, two, three = np.split(np.asarray(Image.open(path).convert("L")).astype(int), 3, axis=1)
        assert min(np.abs(one - two).mean(), np.abs(two - three).mean()) > 1, path.name


def test_the_search_knows_each_page(site, pages):
    index = json.loads((site / "search" / "search_index.json").read_text("utf-8"))
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert found >= {path.relative_to(site).as_posix() for path in pages if path.name != "index.html"}


def test_search_works_from_a_disk(browser, site):
    browser.get((site / "index.html").as_uri())
    browser.find_element("css selector", "input.md-search__input").send_keys("disparity")
    wait(browser, lambda: browser.find_elements("css selector", ".md-search-result__item a"))
    requests = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {each["params"]["request"]["url"] for each in requests if each["method"] == "Network.requestWillBeSent"}
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:", "about:", "chrome:"))] == []


def test_pages_read_alike_as_plain_markdown():
    """A code host knows CommonMark: lists, code and tables must be the same there and on the site."""
    import markdown
    from markdown_it import MarkdownIt

    def shape(html):
        return re.findall(r"<(h\d|pre|ul|ol|li|table|tr|blockquote|img)\b", html)

    host = MarkdownIt("commonmark").enable("table")
    for page in PAGES:
        text = page.read_text("utf-8")
        ours = markdown.markdown(text, extensions=["tables", "pymdownx.superfences"])
        assert shape(ours) == shape(host.render(text)), page
