"""Numbers spread evenly: a sample of many pairs, the pixels of a smaller image."""


def centres(count: int, parts: int) -> list[int]:
    """Return the number in the middle of each of ``parts`` equal parts of ``range(count)``, rising.

    With more parts than numbers, numbers repeat.
    """
    return [(2 * part + 1) * count // (2 * parts) for part in range(parts)]


def spread(count: int, wanted: int) -> list[int]:
    """Return ``wanted`` numbers below ``count``, or all of them, evenly spread and rising."""
    return centres(count, min(count, wanted))
