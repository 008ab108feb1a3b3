"""What can go wrong, as types.

``ConfigError`` and ``UnknownPlugin`` are the user's to mend: the command line prints them as one line and exits with 2.
``RemoteProtocolError`` is a peer's fault: it is logged, its message is dropped, and life goes on.
"""


class ZswarmError(Exception):
    """Everything that zswarm raises on purpose."""


class ConfigError(ZswarmError):
    """A file, option or name that the user gave cannot be used; the text says what was expected.

    Attributes:
        path: of the key that it is about, where it is about one.
    """

    def __init__(self, text: str, path: tuple[str, ...] = ()) -> None:
        super().__init__(text)
        self.path = path


class KeysError(ConfigError):
    """Keys, or a file that holds some, cannot be used; the text says why, and what to do."""


class UnknownPlugin(ConfigError):
    """No simulator, representation or optimizer of that name is installed."""


class Stopped(ZswarmError):
    """What went on was stopped from outside; a run can be resumed."""


class NoServers(ZswarmError):
    """No server that matches the experiment answered in time."""


class NoRouter(NoServers):
    """No router through which servers could be reached answered in time."""


class ProtocolError(ZswarmError):
    """A rule of the wire protocol was broken."""


class LocalProtocolError(ProtocolError):
    """We broke it: a bug."""


class RemoteProtocolError(ProtocolError):
    """A peer broke it."""


class EvaluationError(ZswarmError):
    """Trials could not be evaluated: a fault of machines or programs, never of a candidate's behaviour."""
