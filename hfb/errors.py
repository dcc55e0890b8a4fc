"""Exceptions whose text is the sentence that a user reads; it names the fix."""


class InputError(ValueError):
    """Something the user gave cannot be used; the command line prints the message and exits with 2.

    Bytes of a file's name that are no text in UTF-8 are shown as escapes: the sentence can be written anywhere.
    """

    def __init__(self, sentence: str = "") -> None:
        super().__init__(sentence.encode("utf-8", "backslashreplace").decode())


class TemporaryError(InputError):
    """What is wrong lies beside what was given, and ends or is mended without another input: a cluster that is down."""


class Busy(TemporaryError):
    """Another process works there: waiting mends it."""


class InfrastructureError(Exception):
    """Something that a run stands on gave out half-way: a disk, a server, memory.

    Its text names the fix. What is finished is kept, and the same command goes on from there.
    """


class ServerLost(InfrastructureError):
    """The server that a run is told to no longer answers: nothing more can be reported to it."""
