"""The one error boundary: what a user can mend is a SmootherError, everything else is a bug with a traceback."""


class SmootherError(Exception):
    """Base of all errors that a person can mend; the command line prints them in one line and exits with 2.

    Texts quote files: whatever they hold, a message has no control characters.
    """

    def __init__(self, text: str = "") -> None:
        super().__init__("".join(c if c.isprintable() else " " for c in text))


class SessionError(SmootherError):
    """A recording, or a file of it, cannot be used. The text names file, place and remedy."""


class ConfigError(SmootherError):
    """A settings file has an unknown key or an impossible value. The text names file, key and remedy."""


class UsageError(SmootherError):
    """The arguments of a command do not fit together."""
