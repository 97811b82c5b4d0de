"""The templates in assets/, from which pages, cards and configs are written."""

from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape

from semisynth_gl.inputs.resources import data_root


def template_environment() -> Environment:
    """Return an environment that finds templates in assets/ by name, and escapes values only in HTML templates.

    A line with only a tag adds no empty line. The filter ``spec`` is Python's `format`. A missing value is an error.
    """
    environment = Environment(
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=FunctionLoader(lambda name: data_root("assets").joinpath(name).read_text("utf-8")),
    )
    environment.filters["spec"] = format
    return environment
