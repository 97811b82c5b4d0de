"""The options of a command in errors about the library's arguments."""

from typing import Any

import click

from semisynth_gl.inputs.errors import InputError, SemisynthError

# Parameters of commands whose name differs from the library's argument.
_PARAMETERS = {"overrides": "settings"}


def in_options(error: SemisynthError, command: click.Command) -> str:
    """Put a command's option in place of the argument that an `InputError` is about; return the message."""
    if isinstance(error, InputError):
        name = _PARAMETERS.get(error.argument, error.argument)
        options = {each.name: max(each.opts, key=len) for each in command.params if isinstance(each, click.Option)}
        error.argument = options.get(name, error.argument)
    return str(error)


class Command(click.Command):
    """A command whose errors name its options."""

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - click's signature
        """Run the command."""
        try:
            return super().invoke(ctx)
        except SemisynthError as error:
            in_options(error, self)
            raise
