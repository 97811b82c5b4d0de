"""Facts in the documentation that the program confirms."""

import re
from pathlib import Path

from snippets import referenced_names

import semisynth_gl
from semisynth_gl import judge
from semisynth_gl.config import Config
from semisynth_gl.config.explain import config_keys, meaning

ROOT = Path(__file__).resolve().parents[2]
TORCH_NAMES = re.findall(
    r'"(\w+)"', (ROOT / "semisynth_gl/torch/__init__.py").read_text("utf-8").partition("__all__")[2]
)
FOLDERS_OF_PAGES = (".", "docs", "docs/reference", "benchmarks/results", "benchmarks/peers", "examples", "shaders")
PAGES = [page for folder in FOLDERS_OF_PAGES for page in sorted((ROOT / folder).glob("*.md"))]


def test_every_key_is_documented_by_its_docstring():
    keys = config_keys()
    assert {name for name in keys if "." not in name} == Config.model_fields.keys()
    assert [name for name, field in keys.items() if not meaning(field)] == []


def test_the_reference_shows_each_public_name_once():
    names = [f"semisynth_gl.{name}" for name in semisynth_gl.__all__]
    names += [f"semisynth_gl.torch.{name}" for name in TORCH_NAMES]
    names += [f"semisynth_gl.judge.{name}" for name in judge.__all__ if name not in semisynth_gl.__all__]
    assert sorted(referenced_names()) == sorted(names)


def prose(page):
    """Return a page without code blocks, in which # begins a comment, not a heading."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(page):
    """Return GitHub's anchors of a page's headings, and the site's anchors of public names."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    named = {f"semisynth_gl.{name}" for name in semisynth_gl.__all__ if "\n::: semisynth_gl\n" in prose(page)}
    return named | {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_lead_somewhere():
    links = [
        (page, target, anchor)
        for page in PAGES
        for target, anchor in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", prose(page))
        if "://" not in target
    ]
    dead = [f"{page.name}: {target}" for page, target, _ in links if not (page.parent / target).exists()]
    assert dead == []
    anchored = [((page.parent / target) if target else page, anchor) for page, target, anchor in links if anchor]
    assert [f"{page.name}#{anchor}" for page, anchor in anchored if anchor not in anchors(page)] == []
    assert len(links) > len(PAGES)
    assert len(anchored) > 1
