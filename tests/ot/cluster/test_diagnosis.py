"""What is named that keeps servers from being found."""

import socket

from zswarm.ot.cluster import diagnosis
from zswarm.session import Reach


def test_endpoints_that_cannot_be_dialled_are_named_with_the_reason() -> None:
    """Those with the same reason share a line; one where something listens is not named."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
    ends = [f"tcp/127.0.0.1:{one.getsockname()[1]}" for one in sockets]
    sockets[0].close()
    sockets[2].close()
    with sockets[1]:
        lines = diagnosis.unreachable(Reach(ends, multicast=False))
    assert len(lines) == 1
    assert lines[0].startswith(f"{ends[0]}, {ends[2]}: nothing listens there")
