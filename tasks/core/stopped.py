"""The error of a computation that nobody waits for any more. Light to import."""


class Stopped(Exception):
    """The workers were told to stop: nobody waits for this computation any more."""
