"""The table of a server's phases."""

import itertools

import pytest

from tests.ot.cluster.dispatching import Optimizer, offer, terms
from zswarm.errors import LocalProtocolError
from zswarm.ot.cluster.events import Outbox, Seen
from zswarm.ot.cluster.remote_server import MOVES, Phase, RemoteServer
from zswarm.ot.cluster.servers import Servers
from zswarm.protocol import codec
from zswarm.protocol.messages import Reserve, proof


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


def test_each_server_is_sent_its_own_proof_of_the_runs_secret() -> None:
    optimizer = Optimizer(secret=b"secret of the run")
    proofs = []
    for server in ("a", "b"):
        (ask,) = optimizer.feed(Seen(server))
        assert b"proof" not in codec.encode(ask.message)
        (ask,) = optimizer.answer(ask, offer(1))
        assert isinstance(ask.message, Reserve)
        assert ask.message.proof == proof(b"secret of the run", server)
        proofs.append(ask.message.proof)
    assert len({*proofs, b"secret of the run"}) == 3
