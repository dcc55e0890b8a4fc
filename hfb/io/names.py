"""Names of files as text: what a server, a record or a line of a log can hold. Light to import."""


def is_text(name: object) -> bool:
    """Whether a file's name is text in UTF-8; servers, records and pages take no other bytes."""
    try:
        str(name).encode()
    except UnicodeEncodeError:
        return False
    return True


def shown_name(name: str) -> str:
    """A file's name for a line of text: control characters and bytes that are no text as escapes."""
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in name)
