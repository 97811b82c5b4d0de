"""What the library says, in the words of a command: the options instead of the arguments and keys that they set."""

import re
from typing import Any

import click

from semisynth_gl.inputs.errors import SemisynthError

# Messages have the names of arguments, and of keys that an option sets, in backticks.
_NAMED = re.compile(r"`([a-z][a-z_.]*)`")
# Parameters of commands by what they are called in Python or in a config, where that is another name.
_PARAMETERS = {"textures.images": "images", "models.folders": "models", "overrides": "settings"}


def in_options(text: str, command: click.Command) -> str:
    """Return a message of the library, such as "another folder for `out`", with a command's options in it.

    What the command has no option for stays as it is.
    """
    options = {param.name: max(param.opts, key=len) for param in command.params if isinstance(param, click.Option)}
    return _NAMED.sub(lambda found: options.get(_PARAMETERS.get(found[1], found[1]), found[0]), text)


class Command(click.Command):
    """A command whose errors name its options."""

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - click's signature
        """Run the command; the library's errors leave it with options in their messages."""
        try:
            return super().invoke(ctx)
        except SemisynthError as error:
            error.args = (in_options(str(error), self),)
            raise
