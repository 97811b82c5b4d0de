"""Tables that read well as plain text too."""

from collections.abc import Sequence


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]], *, text_last: bool = True) -> str:
    """A table whose columns line up in plain text too.

    Numbers stand to the right; the first column, and the last if it is text, to the left.
    """
    to_left = (0, len(head) - 1) if text_last else (0,)
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.ljust(width) if column in to_left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = [
        "-" * width if column in to_left else "-" * (width - 1) + ":"
        for column, width in enumerate(widths)
    ]  # fmt: skip
    return "\n".join([line(head), line(rule), *(line(row) for row in rows)])
