"""Numbers spread evenly, such as a sample of many pairs, or the pixels of a smaller image."""


def centres(count: int, parts: int) -> list[int]:
    """Return the number in the middle of each of ``parts`` equal parts of ``range(count)``, in rising order.

    With more parts than numbers, numbers repeat.
    """
    return [(2 * part + 1) * count // (2 * parts) for part in range(parts)]


def spread(count: int, wanted: int) -> list[int]:
    """Return ``wanted`` numbers of ``range(count)``, evenly spread and rising, or all where there are no more."""
    return centres(count, min(count, wanted))
