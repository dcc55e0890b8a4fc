"""The one exception a user can cause: its text is the sentence they read, and it names the fix."""


class InputError(ValueError):
    """Something the user gave cannot be used; the command line prints the message and exits with 2."""
