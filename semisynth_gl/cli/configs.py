"""``semisynth-gl configs``."""

import click

from semisynth_gl.cli.options import Command
from semisynth_gl.config.explain import explain
from semisynth_gl.config.load import load_config, summaries


@click.command(cls=Command)
@click.argument("config_name", type=click.Path(), metavar="[NAME_OR_PATH]", required=False)
def configs(config_name: str | None) -> None:
    """List the packaged configs, or print a config in full.

    The printed config has all keys, defaults and comments. Save it, change it, and pass it to generate.
    """
    if config_name is not None:
        click.echo(explain(load_config(config_name)), nl=False)
        return
    for name, summary in summaries().items():
        click.echo(f"{name:30}{summary}")
