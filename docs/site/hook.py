"""Adds to the site: files outside docs/ that pages link to, the gallery, and the table of a config's keys."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files, InclusionLevel
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from semisynth_gl.config import Range
from semisynth_gl.config.explain import config_keys, meaning, section_of
from semisynth_gl.config.fields import range_to_yaml
from semisynth_gl.config.yaml_values import write_yaml

ROOT = Path(__file__).resolve().parents[2]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add files outside docs/ that pages link to, and the gallery with its pictures."""
    for place, path in _files_beside_docs(config):
        # Pages of benchmarks/ are reached by links, not by the navigation.
        level = InclusionLevel.NOT_IN_NAV if place.startswith("benchmarks/") else InclusionLevel.INCLUDED
        file = File.generated(config, place, abs_src_path=str(path), inclusion=level)
        # These properties keep the file's address below the site's root when src_uri becomes relative to docs/.
        _ = file.dest_uri, file.url
        file.src_uri = f"../{place}"
        files.append(file)
    gallery = _gallery(config)
    files.append(File.generated(config, "gallery.md", abs_src_path=str(gallery / "gallery.md")))
    for path in sorted(gallery.glob("*/*.jpg")):
        place = f"gallery/{path.parent.name}/{path.name}"
        files.append(File.generated(config, place, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Replace ``<!-- keys -->`` in docs/config.md by the table of keys."""
    return markdown.replace("<!-- keys -->", keys_tables())


def keys_tables() -> str:
    """Return a table of each section's keys, from their docstrings."""
    lines = [*_HEAD]
    for name, field in config_keys().items():
        if (section := section_of(field)) is not None:
            lines += ["", f"### {name}", "", _text(section.__doc__ or ""), "", *_HEAD]
        else:
            default = ", ".join(filter(None, ("range" if _is_range(field.annotation) else "", _default(field))))
            lines.append(f"| `{name.rpartition('.')[2]}` | {default} | {_text(meaning(field))} |")
    return "\n".join(lines)


_HEAD = ("| key | default | meaning |", "|---|---|---|")


def _text(docstring: str) -> str:
    return " ".join(docstring.replace("``", "`").split())


def _is_range(annotation: Any) -> bool:  # noqa: ANN401 - any annotation
    """Return whether a key takes a range; a list of ranges does not count."""
    return annotation is Range or (get_origin(annotation) is not tuple and any(map(_is_range, get_args(annotation))))


def _default(field: FieldInfo) -> str:
    """Return a key's default as YAML; "" if it is None or empty, or if the key's docstring states it."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    return "" if value in (None, (), {}) or isinstance(value, BaseModel) else write_yaml(_plain(value))


def _plain(value: Any) -> Any:  # noqa: ANN401 - any value of a config
    if isinstance(value, Range):
        value = range_to_yaml(value)
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _files_beside_docs(config: MkDocsConfig) -> Iterator[tuple[str, Path]]:
    """Yield each file with its path relative to the project's folder."""
    for pattern in config.extra["beside_docs"]:
        for path in sorted(path for path in ROOT.glob(pattern) if path.is_file()):
            yield path.relative_to(ROOT).as_posix(), path


def _gallery(config: MkDocsConfig) -> Path:
    folder = ROOT / config.extra["gallery"]
    if not (folder / "gallery.md").is_file():
        raise PluginError(f"the gallery is missing: python docs/make_gallery.py {folder}")
    return folder
