"""The documentation as a site: built as `make docs` builds it, with links that lead somewhere."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest
from backends import backend_fault
from heavy import heavy
from snippets import ROOT, referenced_names

from semisynth_gl.config import packaged_configs
from semisynth_gl.frame.channels import CHANNELS
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS

sys.path.insert(0, str(ROOT / "docs"))

import make_gallery

mkdocs = heavy("mkdocs")
pytestmark = pytest.mark.heavy


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
