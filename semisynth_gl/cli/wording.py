"""A command whose errors name its options."""

from typing import Any

import click

from semisynth_gl.inputs.errors import InputError

# Parameters of commands whose name differs from the library's argument.
_PARAMETERS = {"overrides": "settings"}


class Command(click.Command):
    """A command that puts its option in place of the argument that an `InputError` is about."""

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - click's signature
        """Run the command."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            name = _PARAMETERS.get(error.argument, error.argument)
            options = {each.name: max(each.opts, key=len) for each in self.params if isinstance(each, click.Option)}
            error.argument = options.get(name, error.argument)
            raise
