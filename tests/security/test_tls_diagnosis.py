"""Issued keys make mutual TLS between their holders only, by OpenSSL's strict rules."""

import socket
import ssl
import threading
from pathlib import Path

import pytest

from tests.lab_keys import installed, issued, of, unpacked

STRICT = ssl.VERIFY_X509_STRICT


def context(keys: Path, *, server: bool) -> ssl.SSLContext:
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    made.load_verify_locations(keys / "authority.pem")
    made.load_cert_chain(keys / "certificate.pem", keys / "key.pem")
    made.verify_mode = ssl.CERT_REQUIRED
    made.verify_flags |= STRICT
    return made


def greet(server: ssl.SSLContext, client: ssl.SSLContext, name: str) -> tuple[str, str]:
    """Common names as both sides see each other's.

    Raises:
        ssl.SSLError: one side refuses the other.
    """
    here, there = socket.socketpair()
    seen: list[str] = []
    refused: list[Exception] = []

    def serve() -> None:
        try:
            with server.wrap_socket(there, server_side=True) as wrapped:
                seen.append(common_name(wrapped))
                wrapped.sendall(wrapped.recv(1))
        except (ssl.SSLError, OSError) as error:
            refused.append(error)

    thread = threading.Thread(target=serve)
    here.settimeout(20.0)
    there.settimeout(20.0)
    thread.start()
    try:
        with client.wrap_socket(here, server_hostname=name) as wrapped:
            wrapped.sendall(b"x")
            assert wrapped.recv(1) == b"x"  # only now a server that refuses has said so
            server_name = common_name(wrapped)
    finally:
        here.close()
        thread.join()
        there.close()
    return server_name, seen[0]


def common_name(wrapped: ssl.SSLSocket) -> str:
    subject = (wrapped.getpeercert() or {})["subject"]
    return str(dict(part[0] for part in subject)["commonName"])  # type: ignore[misc, index]


@pytest.fixture
def lab(tmp_path: Path) -> tuple[Path, Path]:
    server, user = issued(tmp_path / "authority", of("ss", "lab-01"), of("ot", "alice"))
    return installed(tmp_path / "server", server), installed(tmp_path / "user", user)


@pytest.mark.parametrize("name", ["lab-01", "lab-01.local", "127.0.0.1", "localhost"])
def test_holders_of_one_authority_see_who_the_other_is(
    lab: tuple[Path, Path], name: str
) -> None:
    server, user = lab
    assert greet(context(server, server=True), context(user, server=False), name) == (
        "ss.lab-01",
        "ot.alice",
    )


def test_a_server_under_another_name_is_refused(lab: tuple[Path, Path]) -> None:
    server, user = lab
    with pytest.raises(ssl.SSLCertVerificationError, match="lab-02"):
        greet(context(server, server=True), context(user, server=False), "lab-02")


def test_the_keys_of_another_authority_are_refused_by_both_sides(
    tmp_path: Path, lab: tuple[Path, Path]
) -> None:
    server, user = lab
    theirs, them = issued(tmp_path / "other", of("ss", "lab-01"), of("ot", "alice"))
    their_server, their_user = (
        unpacked(tmp_path / "their-server", theirs),
        unpacked(tmp_path / "their-user", them),
    )
    with pytest.raises(ssl.SSLCertVerificationError):
        greet(context(their_server, server=True), context(user, server=False), "lab-01")
    blind = context(their_user, server=False)
    blind.check_hostname, blind.verify_mode = False, ssl.CERT_NONE
    with pytest.raises((ssl.SSLError, ConnectionError)):
        greet(context(server, server=True), blind, "lab-01")


def test_clients_without_keys_are_refused(lab: tuple[Path, Path]) -> None:
    bare = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    bare.load_verify_locations(lab[0] / "authority.pem")
    with pytest.raises((ssl.SSLError, ConnectionError)):
        greet(context(lab[0], server=True), bare, "lab-01")
