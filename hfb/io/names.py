"""File names as text for servers, records and logs. Light to import."""


def is_text(name: object) -> bool:
    """Return whether a file's name is text in UTF-8; servers, records and pages accept no other bytes.

    Args:
        name: or path.
    """
    try:
        str(name).encode()
    except UnicodeEncodeError:
        return False
    return True


def shown_name(name: str) -> str:
    """Return a file's name for a line of text: control characters and undecodable bytes as escapes.

    Args:
        name: name of a file.
    """
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in name)
