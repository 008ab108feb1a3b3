"""Endpoints: what zenoh can use is taken apart, everything else is refused in one line."""

import pytest

from zswarm.errors import ConfigError
from zswarm.protocol import endpoint
from zswarm.protocol.endpoint import Endpoint


@pytest.mark.parametrize(
    ("text", "parsed"),
    [
        ("tcp/192.168.1.5:7467", Endpoint("tcp", "192.168.1.5", 7467)),
        ("tls/lab3.example.org:7467", Endpoint("tls", "lab3.example.org", 7467)),
        ("tcp/[2001:db8::1]:7467", Endpoint("tcp", "2001:db8::1", 7467)),
        ("quic/127.0.0.1:0", Endpoint("quic", "127.0.0.1", 0)),
        (
            "tcp/10.0.0.1:7467?prio=1#iface=eth0;so_sndbuf=65536",
            Endpoint("tcp", "10.0.0.1", 7467),
        ),
        (
            "unixsock-stream//run/zswarm.sock",
            Endpoint("unixsock-stream", "/run/zswarm.sock", 0),
        ),
    ],
)
def test_an_endpoint_has_a_protocol_and_an_address(text: str, parsed: Endpoint) -> None:
    assert endpoint.parse(text) == parsed


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the part before the first /"),
        ("nonsense", "the part before the first /"),
        ("192.168.1.5:7467", "the part before the first /"),
        ("http://192.168.1.5:7467", "the part before the first /"),
        ("serial//dev/ttyS0", "the part before the first /"),
        ("tcp/192.168.1.5", "HOST:PORT"),
        ("tcp/:7467", "HOST:PORT"),
        ("tcp//192.168.1.5:7467", "HOST:PORT"),
        ("tcp/2001:db8::1:7467", "in brackets"),
        ("tcp/host:", "the port"),
        ("tcp/host:65536", "the port"),
        ("tcp/host:http", "the port"),
        ("tcp/host:\u0667", "the port"),
        ("tcp/my host:7467", "a space"),
        ("tcp/host\n:7467", "control character"),
        ("unixsock-stream/zswarm.sock", "must begin with /"),
    ],
)
def test_any_other_endpoint_is_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        endpoint.check(["tcp/192.168.1.5:7467", text], "connect")
    told = str(refused.value)
    assert told.startswith(
        f"connect: expected endpoints such as tcp/192.168.1.5:7467, not {text!r}"
    )
    assert words in told
    assert "\n" not in told
