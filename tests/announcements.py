"""What the program says on stderr of the work ahead, which depends on what earlier tests left in the cache."""

import re


def without_announcements(stderr: str) -> str:
    """Leave out the lines that say what is made now and found by later runs."""
    return re.sub(r"^making .+\n", "", stderr, flags=re.MULTILINE)
