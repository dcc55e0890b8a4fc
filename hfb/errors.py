"""Exceptions with a sentence for the user, which names the fix."""


class InputError(ValueError):
    """The user's input cannot be used; the command line prints the message and exits with 2.

    Bytes of a file's name that are not UTF-8 are shown as escapes, so that the sentence can be written anywhere.

    Args:
        sentence: problem and fix, for the user.
    """

    def __init__(self, sentence: str = "") -> None:
        super().__init__(sentence.encode("utf-8", "backslashreplace").decode())


class TemporaryError(InputError):
    """Temporary failure unrelated to the input, such as a cluster that is down; retrying may succeed."""


class Busy(TemporaryError):
    """Another process holds the resource; waiting helps."""


class InfrastructureError(Exception):
    """A disk, a server or memory failed during a run.

    Its text names the fix. Finished work is kept, and the same command resumes from there.
    """


class ServerLost(InfrastructureError):
    """The server that a run reports to no longer answers."""


def install_advice(extra: str) -> str:
    """Return how to install an extra of hfb, which is on no package index: from its checkout or its wheel's file.

    Args:
        extra: as pyproject.toml names it.
    """
    wheel = f"hfb-VERSION-py3-none-any.whl[{extra}]"
    return f"run `pip install '.[{extra}]'` in hfb's checkout, or `pip install '{wheel}'` with the wheel's file"
