"""Plug-ins: layouts, texture sources, families of models and scene recipes of other installed packages.

A package has an entry point in the group ``semisynth_gl.plugins``, which refers to a mapping of plug-ins by `Group` and
name. Each process imports all these packages when it first asks for a plug-in; their own exceptions pass through.
"""

import hashlib
import sys
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import Distribution, entry_points
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import Field
from typing_extensions import TypedDict  # pydantic takes that of typing only from Python 3.12 on

from semisynth_gl.inputs.errors import InputError, did_you_mean, near, shown

Group = Literal["layouts", "textures", "models", "recipes"]
"""The sorts of plug-ins."""

NOUNS: Mapping[Group, str] = {
    "layouts": "layout",
    "textures": "texture source",
    "models": "family of models",
    "recipes": "scene recipe",
}
"""The groups, and the noun for a plug-in of each for messages."""

BUILT_IN: Mapping[Group, tuple[str, ...]] = {
    "layouts": ("crestereo", "eth3d", "kitti", "middlebury", "middlebury-2014", "sceneflow", "webdataset"),
    "textures": ("images", "builtin", "photographs", "procedural"),
    "models": (),  # a config has their weights beside those of plug-ins, not among them
    "recipes": (),
}
"""The names of the program's own, which no plug-in may have."""

# Messages put it into a command.
_Text = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+!-]*$", max_length=100)]


class Package(TypedDict):
    """Name and version of a plug-in's package."""

    package: _Text
    version: _Text


Records = Mapping[str, Mapping[str, Package]]
"""The package of each plug-in by group and name, in JSON's types."""


@dataclass(frozen=True)
class Plugin:
    """What an installed package gives under a name; ``module`` is the package's top module."""

    group: Group
    name: str
    package: str
    version: str
    module: str
    value: Any = field(repr=False)

    def __str__(self) -> str:
        return f"{NOUNS[self.group]} {self.name!r} of the package {self.package} {self.version}"

    @property
    def record(self) -> Package:
        """The plug-in's package and its version, as datasets record them; see `Records`."""
        return {"package": self.package, "version": self.version}

    @property
    def code_sha256(self) -> str:
        """SHA-256 of all modules of the package; raises OSError where they are not in files."""
        top = sys.modules[self.module]
        path = Path(next(iter(getattr(top, "__path__", None) or [str(top.__file__)])))
        return modules_sha256(path)


@cache
def modules_sha256(path: Path) -> str:
    """Return the SHA-256 of all modules below a folder, or of the module at a path; raises OSError for neither."""
    modules = sorted(path.rglob("*.py")) or [path]
    return hashlib.sha256(b"\0".join(module.read_bytes() for module in modules)).hexdigest()


@cache
def installed_plugins() -> Mapping[tuple[Group, str], Plugin]:
    """Import the plug-ins of all installed packages; raises InputError where a name is already taken."""
    found: dict[tuple[Group, str], Plugin] = {}
    for entry in entry_points(group="semisynth_gl.plugins"):
        package = cast("Distribution", entry.dist)
        for group, values in entry.load().items():
            for name, value in values.items():
                plugin = Plugin(group, name, package.name, package.version, entry.module.partition(".")[0], value)
                if name in BUILT_IN[group] or (group, name) in found:
                    other = found.get((group, name), f"a built-in {NOUNS[group]}")
                    raise InputError(f"{plugin} has the name of {other}: rename it, or pip uninstall {package.name}")
                found[group, name] = plugin
    return found


def names_of_group(group: Group) -> list[str]:
    """Return the names of a group, sorted: the program's own and those of installed plug-ins."""
    return sorted([*BUILT_IN[group], *(name for each, name in installed_plugins() if each == group)])


def find_plugin(group: Group, name: str) -> Plugin:
    """Return the plug-in of a name; raises InputError where no installed package has it."""
    if plugin := installed_plugins().get((group, name)):
        return plugin
    known = names_of_group(group)
    expected = f"expected one of {', '.join(known)}" if known else "no installed package has any"
    hint = did_you_mean(near(name, known))
    raise InputError(f"{NOUNS[group]}: {expected}, got {shown(name)}; {hint}".removesuffix("; "))


def plugin_records(used: Iterable[tuple[Group, str]]) -> dict[str, dict[str, Package]]:
    """Return the records of the plug-ins that a dataset uses, by group and name; raises as `find_plugin` does."""
    records: dict[str, dict[str, Package]] = {}
    for group, name in sorted(used, key=lambda each: ([*NOUNS].index(each[0]), each[1])):
        records.setdefault(group, {})[name] = find_plugin(group, name).record
    return records


def require_plugins(
    where: object, records: Records, groups: Collection[Group] = tuple(NOUNS), *, same: bool = False
) -> None:
    """Check that the plug-ins of a dataset's records are installed, for some groups.

    Where ``same`` is set, they must come from the same packages in the same versions. Raises InputError, which begins
    with ``where`` and tells the command that installs the package, where a plug-in is missing.
    """
    for group in groups:
        for name, record in records.get(group, {}).items():
            plugin = installed_plugins().get((group, name))
            if plugin is None or (same and plugin.record != record):
                package, version = record["package"], record["version"]
                raise InputError(
                    f"{where}: {NOUNS[group]} {name!r} comes from the plug-in package {package} {version}, which is "
                    f"not installed: pip install {package}=={version}"
                )
