"""Stereo training pairs from photographs, rendered headless with exact disparity.

`load_config` and `render_pair` are the short way; `generate` and `open_dataset` write and read whole datasets.
`Renderer` draws scenes made by hand: meshes, patches, instances and cameras as arrays. Importing this package loads no
OpenGL. Its public names are in ``__init__.pyi``, and loaded when they are first used; docs/python.md says what may
change.
"""

# No imports at module level: `__main__` lets Ctrl-C end the program quietly only once this module is loaded.


def _modules() -> dict[str, str]:
    """Return the modules of the public names."""
    import ast  # noqa: PLC0415 - see above
    from pathlib import Path  # noqa: PLC0415

    body = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body
    lines = [statement for statement in body if isinstance(statement, ast.ImportFrom)]
    return {alias.name: str(line.module) for line in lines for alias in line.names}


def __dir__() -> list[str]:
    return [*__getattr__("__all__"), "__version__", "__doc__"]


def __getattr__(name: str):  # noqa: ANN202 - any public name; type checkers read __init__.pyi
    from importlib import import_module, metadata  # noqa: PLC0415 - see above

    if name == "__version__":
        return metadata.version("semisynth-gl")
    if name.startswith("__") and name != "__all__":
        raise AttributeError(f"module {__name__} has no attribute {name}")
    modules = _modules()
    if name == "__all__":
        return sorted(modules)
    if name not in modules:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    # Kept: the next use asks nobody.
    globals()[name] = getattr(import_module(modules[name]), name)
    return globals()[name]
