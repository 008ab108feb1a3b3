"""The exceptions that zswarm raises.

The command line prints a ``ConfigError`` as one line and exits with code 2. A
``RemoteProtocolError`` is the fault of a peer: it is logged, and its message is dropped.
"""


class ZswarmError(Exception):
    """Base class of all exceptions below."""


class ConfigError(ZswarmError):
    """A file, option or name from the user cannot be used; the message says what was expected.

    Attributes:
        path: of the key at fault, if it is one.
    """

    def __init__(self, text: str, path: tuple[str, ...] = ()) -> None:
        super().__init__(text)
        self.path = path


class KeysError(ConfigError):
    """Keys, or a file of keys, cannot be used; the message gives the reason and the remedy."""


class UnknownPlugin(ConfigError):
    """No simulator, representation, optimizer or ranking of that name is installed."""


class Stopped(ZswarmError):
    """A run was stopped from outside; it can be resumed."""


class NoServers(ZswarmError):
    """No server that matches the experiment answered in time."""


class NoRouter(NoServers):
    """No router to the servers answered in time."""


class ProtocolError(ZswarmError):
    """A rule of the wire protocol was broken."""


class LocalProtocolError(ProtocolError):
    """This program broke it: a bug."""


class RemoteProtocolError(ProtocolError):
    """A peer broke it."""


class UnknownMessageError(RemoteProtocolError):
    """A peer sent a message of a type that this program does not have: it may be newer."""


class EvaluationError(ZswarmError):
    """Trials could not be evaluated: a fault of machines or programs, not of a candidate."""
