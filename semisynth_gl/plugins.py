"""Plug-ins: layouts, texture sources, families of models and scene recipes of other installed packages.

A package has an entry point in the group ``semisynth_gl.plugins``. It refers to a mapping of plug-ins by `Group` and
name. Each process imports all these packages when it first needs a plug-in, and does not catch their exceptions.
"""

import hashlib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, entry_points
from pathlib import Path
from typing import Any, Literal, cast

from typing_extensions import TypedDict  # before Python 3.12, pydantic rejects typing's

from semisynth_gl.inputs.errors import InputError, did_you_mean, near, shown

Group = Literal["layouts", "textures", "models", "recipes"]
"""The kinds of plug-ins."""

NOUNS: Mapping[Group, str] = {
    "layouts": "layout",
    "textures": "texture source",
    "models": "family of models",
    "recipes": "scene recipe",
}
"""What messages call a plug-in of each group."""

BUILT_IN: Mapping[Group, tuple[str, ...]] = {
    "layouts": ("crestereo", "eth3d", "kitti", "middlebury", "middlebury-2014", "sceneflow", "webdataset"),
    "textures": ("images", "builtin", "photographs", "procedural"),
    "models": (),  # in configs, built-in models have weights under other keys than plug-ins'
    "recipes": (),
}
"""Names of built-in layouts and texture sources. No plug-in may have these names."""


class PluginPackage(TypedDict):
    """Name and version of a plug-in's package."""

    package: str
    version: str


@dataclass(frozen=True)
class Plugin:
    """A plug-in of an installed package; ``module`` is the package's top module."""

    name: str
    value: Any
    record: PluginPackage
    module: str


@cache
def modules_sha256(path: Path) -> str:
    """Return the SHA-256 of all modules below a folder, or of one module's file; raises OSError if there is neither."""
    modules = sorted(path.rglob("*.py")) or [path]
    return hashlib.sha256(b"\0".join(module.read_bytes() for module in modules)).hexdigest()


@cache
def installed_plugins() -> Mapping[Group, Mapping[str, Plugin]]:
    """Import the plug-ins of all installed packages; raises InputError if two have the same name."""
    found: dict[Group, dict[str, Plugin]] = {group: {} for group in NOUNS}
    for entry in entry_points(group="semisynth_gl.plugins"):
        package = cast("Distribution", entry.dist)
        record: PluginPackage = {"package": package.name, "version": package.version}
        for group, values in entry.load().items():
            for name, value in values.items():
                if name in BUILT_IN[group] or name in found[group]:
                    raise InputError(
                        f"the {NOUNS[group]} {name!r} of the package {package.name} has the name of another "
                        f"{NOUNS[group]}: rename it, or pip uninstall {package.name}"
                    )
                found[group][name] = Plugin(name, value, record, entry.module.partition(".")[0])
    return found


def plugins_sha256() -> list[str]:
    """Return the SHA-256 of all modules of each plug-in's package; raises OSError if a package has no files."""
    names = {plugin.module for plugins in installed_plugins().values() for plugin in plugins.values()}
    tops = [sys.modules[name] for name in sorted(names)]
    return [modules_sha256(Path(next(iter(getattr(top, "__path__", None) or [str(top.__file__)])))) for top in tops]


def find_plugin(group: Group, name: str) -> Plugin:
    """Return the plug-in of a name; raises InputError where no installed package has it."""
    installed = installed_plugins()[group]
    if name in installed:
        return installed[name]
    known = sorted({*BUILT_IN[group], *installed})
    expected = f"expected one of {', '.join(known)}" if known else "no installed package has any"
    hint = did_you_mean(near(name, known))
    raise InputError(f"{NOUNS[group]}: {expected}, got {shown(name)}; {hint}".removesuffix("; "))


def plugin_records(used: Iterable[tuple[Group, str]]) -> dict[str, dict[str, PluginPackage]]:
    """Return the records of the used plug-ins by group and name; raises as `find_plugin` does."""
    records: dict[str, dict[str, PluginPackage]] = {}
    for group, name in sorted(used, key=lambda each: ([*NOUNS].index(each[0]), each[1])):
        records.setdefault(group, {})[name] = find_plugin(group, name).record
    return records


def require_plugins(where: object, group: Group, records: Mapping[str, PluginPackage]) -> None:
    """Raise InputError if a plug-in in a group's records is not installed in the recorded version.

    The message begins with ``where`` and names the package.
    """
    for name, record in records.items():
        plugin = installed_plugins()[group].get(name)
        if plugin is None or plugin.record != record:
            package = f"{record['package']}=={record['version']}"
            raise InputError(
                f"{where}: {NOUNS[group]} {shown(name)} comes from the plug-in package {shown(package)}, which is not "
                "installed"
            )
