"""The templates in assets/, by which pages, cards and configs are written."""

from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape

from semisynth_gl.inputs.resources import data_root


def template_environment() -> Environment:
    """Return an environment that finds templates by name; it escapes values in templates of HTML, and in no others.

    Lines that hold nothing but a tag leave no line, and the filter ``spec`` is Python's `format`.
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
