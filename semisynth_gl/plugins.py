"""Plug-ins: layouts, texture sources, families of models and scene recipes of other installed packages.

Such a package has an entry point in the group ``semisynth_gl.plugins``. It refers to a mapping such as
``{"models": {"knots": make_knot}}``, whose keys are a `Group` and then the plug-in's name. Each process imports these
packages when it first needs a plug-in, and does not catch their exceptions.
"""

import hashlib
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import Distribution, entry_points
from pathlib import Path
from typing import Any, Literal, cast

from typing_extensions import TypedDict  # before Python 3.12, pydantic rejects typing's

from semisynth_gl.inputs.errors import InputError, did_you_mean, most_similar, shown

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
    "models": (),  # configs list built-in kinds of models under other keys than plug-ins
    "recipes": (),
}
"""Names of built-in layouts and texture sources. No plug-in may have these names."""


class PluginPackage(TypedDict):
    """Name and version of a plug-in's package."""

    package: str
    version: str


@dataclass(frozen=True)
class Plugin:
    """A plug-in of an installed package; ``code`` is the folder of the package's modules, or its only module."""

    value: Any
    package: PluginPackage
    code: Path


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
        distribution, plugins = cast("Distribution", entry.dist), entry.load()
        package: PluginPackage = {"package": distribution.name, "version": distribution.version}
        top = sys.modules[entry.module.partition(".")[0]]
        code = Path(next(iter(getattr(top, "__path__", None) or [str(top.__file__)])))
        for group, values in plugins.items():
            for name, value in values.items():
                if name in BUILT_IN[group] or name in found[group]:
                    raise InputError(
                        f"the {NOUNS[group]} {name!r} of the package {distribution.name} has the name of another "
                        f"{NOUNS[group]}: rename it, or pip uninstall {distribution.name}"
                    )
                found[group][name] = Plugin(value, package, code)
    return found


def plugins_sha256() -> list[str]:
    """Return the SHA-256 of all modules of each plug-in's package; raises OSError if a package has no files."""
    codes = {plugin.code for plugins in installed_plugins().values() for plugin in plugins.values()}
    return [modules_sha256(code) for code in sorted(codes)]


def find_plugin(group: Group, name: str) -> Plugin:
    """Return the plug-in of a name; raises InputError where no installed package has it."""
    installed = installed_plugins()[group]
    if name in installed:
        return installed[name]
    known = sorted({*BUILT_IN[group], *installed})
    expected = f"expected one of {', '.join(known)}" if known else "no installed package has any"
    hint = did_you_mean(most_similar(name, known))
    raise InputError(f"{NOUNS[group]}: {expected}, got {shown(name)}; {hint}".removesuffix("; "))


def plugin_packages(used: Collection[tuple[Group, str]]) -> dict[str, dict[str, PluginPackage]]:
    """Return the packages of the used plug-ins by group and name, sorted; raises as `find_plugin` does."""
    names = {group: sorted(name for each, name in used if each == group) for group in NOUNS}
    return {group: {name: find_plugin(group, name).package for name in names[group]} for group in NOUNS if names[group]}


def require_plugins(context: object, group: Group, packages: Mapping[str, PluginPackage]) -> None:
    """Raise InputError unless each named plug-in is installed, from a package of the given name and version.

    The message begins with ``context``.
    """
    for name, package in packages.items():
        plugin = installed_plugins()[group].get(name)
        if plugin is None or plugin.package != package:
            release = f"{package['package']}=={package['version']}"
            raise InputError(
                f"{context}: {NOUNS[group]} {shown(name)} comes from the plug-in package {shown(release)}, which is "
                "not installed"
            )
