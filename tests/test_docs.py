"""Documentation that can be checked against the program."""

import re
from pathlib import Path

from pydantic import BaseModel

from semisynth_gl.config import Config, load_config, packaged_configs
from semisynth_gl.geometry.kinds import COMPLEX_KINDS, SIMPLE_KINDS
from semisynth_gl.textures.image_files import builtin_photographs

ROOT = Path(__file__).resolve().parents[1]


def keys_of(model):
    for name, field in model.model_fields.items():
        annotation = field.annotation
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            yield from keys_of(annotation)
        else:
            yield name


def test_every_key_is_documented():
    text = (ROOT / "docs" / "config.md").read_text()
    missing = [key for key in keys_of(Config) if f"`{key}`" not in text]
    assert missing == []
    assert [name for name in packaged_configs() if f"`{name}`" not in text] == []


def test_the_example_config_loads(tmp_path):
    text = (ROOT / "docs" / "config.md").read_text()
    example = text.split("```yaml\n")[1].split("```")[0]
    (tmp_path / "lab.yaml").write_text(example)
    assert load_config(tmp_path / "lab.yaml").camera.width_px == 1280


def test_counts_in_the_documentation_are_true():
    assert f"{len(SIMPLE_KINDS)} simple and {len(COMPLEX_KINDS)} complex kinds" in (ROOT / "CHANGELOG.md").read_text()
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"the {len(SIMPLE_KINDS) + len(COMPLEX_KINDS)} kinds that are built in" in readme
    assert len(builtin_photographs()) == 8
    assert "the eight photographs in the public domain that scikit-image ships" in readme


def test_links_lead_somewhere():
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"
