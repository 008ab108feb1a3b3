"""The table of a server's phases."""

import itertools

import pytest

from tests.ot.cluster.dispatching import terms
from zswarm.errors import LocalProtocolError
from zswarm.ot.cluster.events import Outbox
from zswarm.ot.cluster.remote_server import MOVES, Phase, RemoteServer
from zswarm.ot.cluster.servers import Servers


@pytest.mark.parametrize(("phase", "to"), list(itertools.product(Phase, Phase)))
def test_a_server_moves_only_as_the_table_allows(phase: Phase, to: Phase) -> None:
    servers, server = Servers(terms(), Outbox()), RemoteServer("a", phase)
    if to in MOVES[phase]:
        servers._move(server, to)
        assert server.phase == to
    else:
        with pytest.raises(LocalProtocolError):
            servers._move(server, to)


def test_every_phase_can_be_reached_and_only_a_banned_server_stays_where_it_is() -> None:
    assert set().union(*MOVES.values()) == set(Phase)
    assert [phase for phase in Phase if not MOVES[phase]] == [Phase.BANNED]
