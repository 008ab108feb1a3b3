"""Which failures of a preparation may pass, so that it is worth another attempt later."""

import errno

from zswarm.errors import EvaluationError

# The disk, memory, descriptors, processes, a network or a file system, or a program that is not
# there yet, such as a ROS master. A file that does not exist or may not be read stays so.
PASSING = {
    getattr(errno, name)
    for name in (
        *("ENOSPC", "EDQUOT", "EIO", "EROFS", "ESTALE", "EBUSY", "ETXTBSY"),
        *("ENOMEM", "EAGAIN", "EMFILE", "ENFILE", "EINTR"),
        *("ECONNREFUSED", "ECONNRESET", "ECONNABORTED", "EPIPE", "ETIMEDOUT"),
        *("EHOSTUNREACH", "EHOSTDOWN", "ENETUNREACH", "ENETDOWN", "EADDRINUSE"),
    )
}


def may_pass(error: BaseException | None) -> bool:
    """Return whether an error, or one that it came from, may be gone later."""
    while error is not None:
        if isinstance(error, EvaluationError | TimeoutError):
            return True
        if isinstance(error, OSError) and error.errno in PASSING:
            return True
        error = error.__cause__ or error.__context__
    return False
