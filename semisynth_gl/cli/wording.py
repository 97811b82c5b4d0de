"""The library's messages in a command's words: options in place of the arguments and keys that they set."""

import re
from typing import Any

import click

from semisynth_gl.inputs.errors import SemisynthError

# In messages, the names of arguments, and of keys that an option sets, are in backticks.
_NAMED = re.compile(r"`([a-z][a-z_.]*)`")
# A command's parameters by their other names in Python or in a config.
_PARAMETERS = {"textures.images": "images", "models.folders": "models", "overrides": "settings"}


def in_options(text: str, command: click.Command) -> str:
    """Return a message of the library, such as "another folder for `out`", with the command's options in it.

    Names in backticks that are no options of the command stay as they are.
    """
    options = {param.name: max(param.opts, key=len) for param in command.params if isinstance(param, click.Option)}
    return _NAMED.sub(lambda found: options.get(_PARAMETERS.get(found[1], found[1]), found[0]), text)


class Command(click.Command):
    """A command whose errors name its options."""

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - click's signature
        """Run the command; put its options into the message of an error of the library, and raise the error again."""
        try:
            return super().invoke(ctx)
        except SemisynthError as error:
            error.args = (in_options(str(error), self),)
            raise
