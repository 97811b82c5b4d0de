"""Documentation that can be checked against the program."""

import functools
import re
import sys
from fnmatch import fnmatch
from itertools import chain
from pathlib import Path
from types import UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

import pytest
from pydantic import BaseModel
from ruamel.yaml import YAML
from snippets import referenced_names

import semisynth_gl
from semisynth_gl import comparison, metrics
from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.config.dataset_sections import ImperfectionsSection
from semisynth_gl.config.distributions import MixturePart, TargetSection
from semisynth_gl.config.explain import explained_keys
from semisynth_gl.config.keys import config_keys, sections_of
from semisynth_gl.config.model import RecipeSection
from semisynth_gl.config.scene_sections import DepthLayerSection
from semisynth_gl.frame.channels import CHANNELS
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.textures.image_files import builtin_photographs

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import make_gallery  # noqa: E402 - a script beside the pages
from make_config import page_with_keys  # noqa: E402 - another

TORCH_NAMES = re.findall(r'^    "(\w+)",$', (ROOT / "semisynth_gl/torch/__init__.py").read_text("utf-8"), re.MULTILINE)
CONFIG_PAGE = (ROOT / "docs" / "config.md").read_text("utf-8")
MKDOCS = YAML().load((ROOT / "mkdocs.yml").read_text("utf-8"))
FOLDERS_OF_PAGES = (".", "docs", "docs/reference", "benchmarks/results", "benchmarks/peers", "examples", "shaders")
PAGES = [page for folder in FOLDERS_OF_PAGES for page in sorted((ROOT / folder).glob("*.md"))]


def rows(heading):
    """The cells of each row of the table with this heading on the page of configs."""
    table = CONFIG_PAGE.split(f"{heading}\n|---")[1].split("\n\n")[0]
    for line in table.splitlines()[1:]:
        yield [cell.strip() for cell in line.strip("|").split("|")]


def models_in(annotation):
    """The models that an annotation names, and the distribution's that stand inside."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Union, UnionType, Annotated):
        return [model for part in get_args(annotation) for model in models_in(part)]
    return []


def test_every_key_is_documented_from_its_docstring():
    assert page_with_keys(CONFIG_PAGE) == CONFIG_PAGE, "run docs/make_config.py"
    keys = explained_keys()
    assert {key.dotted: key.is_section for key in keys} == {
        key.dotted: key.is_section for key in config_keys() if not key.of_form
    }
    assert [key.dotted for key in keys if not key.meaning] == []
    # What stands as a default is one: a config that states it is the config without it.
    plain = load_config("kitti")
    stated = [
        f"{key.dotted}={key.default}"
        for key in keys
        if key.default not in ("", "required") and getattr_path(plain, key.dotted) == default_of(key.dotted)
    ]
    assert len(stated) > 60
    assert load_config("kitti", stated).digest() == plain.digest()


def getattr_path(config, dotted):
    """The value of a key; None below a section that the config does not have."""
    return functools.reduce(lambda at, name: getattr(at, name, None), dotted.split("."), config)


def default_of(dotted):
    """The default of a key, as its section states it."""
    model = Config
    *sections, key = dotted.split(".")
    for section in sections:
        [model] = sections_of(model.model_fields[section].annotation)
    return model.model_fields[key].get_default(call_default_factory=True)


def test_every_key_of_a_layer_is_documented():
    [clutter] = re.findall(r"^- `clutter`.*(?:\n  .*)*", CONFIG_PAGE, re.MULTILINE)
    assert f"{{{', '.join(DepthLayerSection.model_fields)}}}" in " ".join(clutter.split())


def test_every_key_of_a_recipe_is_documented():
    table = rows("| key of a recipe | default | meaning |")
    documented = {name.strip("`"): meaning for names, _, meaning in table for name in names.split(", ")}
    assert documented.keys() == RecipeSection.model_fields.keys()
    for section, meaning in documented.items():
        keys = set(re.findall(r"`(\w+)`", meaning))
        [partial] = models_in(RecipeSection.model_fields[section].annotation) or [None]
        if partial is None:
            continue
        taken, all_keys = partial.model_fields.keys(), Config.model_fields[section].annotation.model_fields.keys()
        assert keys == (all_keys - taken if meaning.startswith("all keys") else taken), section


def test_every_form_of_the_target_is_documented_with_its_keys():
    documented = {form.strip("`"): keys for form, keys, _ in rows("| `form` | keys | shape |")}
    forms = {get_args(model.model_fields["form"].annotation)[0]: model for model in models_in(TargetSection)}
    assert documented.keys() == {*forms, "file"}
    assert "`path`" in documented["file"]
    for form, model in forms.items():
        for key, field in model.model_fields.items():
            if get_origin(field.annotation) is not Literal:
                text = f"`{key}` ({field.default:g})" if isinstance(field.default, float) else f"`{key}`"
                assert text in documented[form]
    assert f"`{{{', '.join(MixturePart.model_fields)}}}`" in documented["mixture"]


def test_every_packaged_config_is_documented():
    assert [name for name in packaged_configs() if f"`{name}`" not in CONFIG_PAGE] == []


def test_the_public_names_are_documented_and_no_others():
    page = (ROOT / "docs" / "python.md").read_text("utf-8")
    table = page.split("| reference | what for | names |\n|---|---|---|\n")[1].split("\n\n")[0]
    named = {row.split("|")[1]: row.split("|")[3].split("`")[1::2] for row in table.splitlines()}
    torch = named.pop(" [PyTorch](reference/torch.md) ")
    assert sorted(chain.from_iterable(named.values())) == sorted(semisynth_gl.__all__)
    assert sorted(torch) == sorted(TORCH_NAMES)


def test_the_reference_shows_each_public_name_once():
    names = [f"semisynth_gl.{name}" for name in semisynth_gl.__all__]
    names += [f"semisynth_gl.torch.{name}" for name in TORCH_NAMES]
    names += [
        f"semisynth_gl.{room.__name__.split('.')[-1]}.{name}"
        for room in (metrics, comparison)
        for name in room.__all__
        if name not in semisynth_gl.__all__
    ]
    assert sorted(referenced_names()) == sorted(names)


def test_the_example_configs_load(tmp_path):
    (tmp_path / "lab.yaml").write_text(CONFIG_PAGE.split("```yaml\n")[1].split("```")[0])
    assert load_config(tmp_path / "lab.yaml").camera.width_px == 1280
    (tmp_path / "mixed.yaml").write_text(CONFIG_PAGE.split("```yaml\n")[2].split("```")[0])
    assert [recipe.share for recipe in load_config(tmp_path / "mixed.yaml").recipes()] == [0.25, 0.5, 0.25]
    (tmp_path / "rooms.yaml").write_text(CONFIG_PAGE.split("```yaml\n")[3].split("```")[0])
    shares = {recipe.name: recipe.share for recipe in load_config(tmp_path / "rooms.yaml").recipes()}
    assert shares == pytest.approx({"room": 2 / 3, "clutter": 1 / 3})
    assert CONFIG_PAGE.count("```yaml\n") == 3


def test_counts_in_the_documentation_are_true():
    simple, complex_ = len(SIMPLE_KINDS), len(COMPLEX_KINDS)
    assert f"{simple} simple and {complex_} complex kinds" in (ROOT / "CHANGELOG.md").read_text("utf-8")
    readme = " ".join((ROOT / "README.md").read_text("utf-8").split())
    assert f"the {simple + complex_} kinds that are built in" in readme
    assert len(builtin_photographs()) == 8
    assert "the eight photographs in the public domain that scikit-image ships" in readme
    pairs = re.search(r"^PAIRS \?= (\d+)$", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE).group(1)
    middlebury, kitti = load_config("middlebury").camera, load_config("kitti").camera
    rendered = re.search(r"renders (\d+) pairs (?:of|at) (\d+) x (\d+)", readme).groups()
    assert rendered == (pairs, str(middlebury.width_px), str(middlebury.height_px))
    assert f"({kitti.height_px}, {kitti.width_px}, 3) uint8" in readme


def prose(page):
    """A page without its blocks of code, where # begins a comment and no heading."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(page):
    """The anchors that GitHub gives the headings of a page, and the site the public names where they are documented."""
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


def pages_of(nav):
    """The pages of a part of the navigation, in order."""
    for entry in nav:
        [named] = entry.values() if isinstance(entry, dict) else [entry]
        yield from [named] if isinstance(named, str) else pages_of(named)


def test_the_site_leads_to_each_page_once():
    named = list(pages_of(MKDOCS["nav"]))
    assert len(set(named)) == len(named)
    assert [page for page in named if not (ROOT / "docs" / page).is_file()] == []
    own = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert own - set(named) == set()


def test_the_site_has_what_its_pages_link_to():
    outside = {
        target[3:] for page in (ROOT / "docs").glob("*.md") for target in re.findall(r"\]\((\.\./[^)#]*)", prose(page))
    } | {page[3:] for page in pages_of(MKDOCS["nav"]) if page.startswith("../")}
    carried = MKDOCS["extra"]["beside_docs"]
    assert [path for path in outside if not any(fnmatch(path, pattern) for pattern in carried)] == []
    assert outside


def test_the_gallery_has_a_picture_of_everything():
    assert make_gallery.SHOWN.keys() == CHANNELS.keys()
    assert make_gallery.IMPERFECTIONS.keys() == ImperfectionsSection.model_fields.keys()
    marks = re.findall(r"<!-- pictures: (.*) -->", (ROOT / "docs" / "gallery.md").read_text("utf-8"))
    assert sorted(marks) == sorted(make_gallery.SECTIONS)
