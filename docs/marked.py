"""The parts of a page that a script writes, between a line that names the script and a closing one."""

END = "<!-- end of the table -->\n"


def replaced(page: str, begin: str, table: str) -> str:
    """Return a page with a table between its opening line and the next closing one.

    Args:
        page: the page's text.
        begin: the opening line, once in the page.
        table: the lines between the two.
    """
    before, rest = page.split(begin)
    _, after = rest.split(END, 1)
    return before + begin + table + END + after
