"""The documentation as a site: built as `make docs` builds it, which ends at a link that leads nowhere."""

import os
import re
import subprocess
import sys

import pytest
from backends import backend_fault
from heavy import heavy
from snippets import ROOT

from semisynth_gl.config.dataset_sections import ImperfectionsSection
from semisynth_gl.config.load import summaries
from semisynth_gl.frame.channels import CHANNELS

sys.path.insert(0, str(ROOT / "docs"))

import make_gallery

mkdocs = heavy("mkdocs")
pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    if backend_fault("auto"):
        pytest.skip("no OpenGL here")
    gallery, folder = tmp_path_factory.mktemp("gallery"), tmp_path_factory.mktemp("site") / "docs"
    with pytest.MonkeyPatch.context() as patch:
        # One config and no imperfections: all of them would take minutes.
        patch.setattr(make_gallery, "summaries", lambda: {"kitti": summaries()["kitti"]})
        patch.setattr(make_gallery, "IMPERFECTIONS", dict.fromkeys(make_gallery.IMPERFECTIONS, ()))
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


def test_pages_load_nothing_from_elsewhere(site):
    pages = [path.read_text("utf-8") for path in site.rglob("*.html") if path.name != "404.html"]
    loads = [address for page in pages for address in re.findall(r'<(?!a\s)[^>]*\s(?:src|href)="([^"]*)"', page)]
    assert len(loads) > 100
    assert [address for address in loads if re.match(r"[a-z]+:|//", address)] == []


def test_the_gallery_has_pictures_of_all_outputs_and_imperfections():
    assert make_gallery.SHOWN.keys() == CHANNELS.keys()
    assert make_gallery.IMPERFECTIONS.keys() == ImperfectionsSection.model_fields.keys()
