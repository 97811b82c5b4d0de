"""Shell completion of the values of options."""

from collections.abc import Callable, Iterable

import click
from click.shell_completion import CompletionItem

Completer = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def one_of(names: Iterable[str]) -> Completer:
    """Return a completer that offers these names."""
    known = tuple(names)
    return lambda _, __, begun: beginning(known, begun)


def some_of(names: Iterable[str]) -> Completer:
    """Return a completer of a list with commas, which offers the names that are not in the list yet."""
    known = tuple(names)

    def complete(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
        before, comma, last = begun.rpartition(",")
        return beginning([name for name in known if name not in before.split(",")], last, before + comma)

    return complete


def beginning(names: Iterable[str], begun: str, before: str = "") -> list[CompletionItem]:
    """Return the names that begin with ``begun``, each with ``before`` in front of it."""
    return [CompletionItem(before + name) for name in names if name.startswith(begun)]
