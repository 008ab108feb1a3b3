"""Lines of zenoh's log in an administrator's words."""

import pytest

from zswarm.security import refusals

LINE = (
    "2026-11-21T23:00:32.460Z  WARN acc-0 zenoh_link_tls::unicast: {}. "
    "Hint: increase the system open file limit.\n"
)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (
            "invalid peer certificate: certificate expired: verification time 1795302032 (UNIX)",
            "its certificate has expired",
        ),
        (
            "invalid peer certificate: certificate not valid yet: verification time 1795302033",
            "is not valid yet",
        ),
        ("received fatal alert: UnknownCA", "does not trust this lab's authority"),
        (
            "invalid peer certificate: UnknownIssuer",
            "its certificate is of another authority",
        ),
        ("peer sent no certificates", "it shows no certificate"),
        ("received corrupt message of type InvalidContentType", "it does not speak TLS"),
    ],
)
def test_a_refused_handshake_is_explained(said: str, words: str) -> None:
    assert words in refusals.handshake_reason(LINE.format(said))


def test_unknown_refusals_are_reported_verbatim_and_cleaned() -> None:
    assert (
        refusals.handshake_reason(LINE.format("something \x1b[2J new"))
        == "something \\x1b[2J new."
    )


@pytest.mark.parametrize(
    "line",
    [
        LINE.format("tls handshake eof"),
        "WARN zenoh_link_tls::utils: Skipping name verification of TLS server\n",
        "anything else\n",
        "",
    ],
)
def test_log_lines_without_refusals_are_not_reported(line: str) -> None:
    assert refusals.handshake_reason(line) == ""


DENIED = (
    "TRACE rx-1 zenoh::net::routing::interceptor::access_control: "
    "61 on Interface(lo)+CertCommonName(ot.bob)+Transport(Tls)+61"
    " is {} to {} on zswarm/v1/default/{}\n"
)


@pytest.mark.parametrize(
    ("verdict", "what", "key", "told"),
    [
        (
            "unauthorized",
            "Query (ingress)",
            "ss/lab-01-01234567/ot/alice/run/cancel",
            True,
        ),
        ("unauthorized", "Query (ingress)", "ss/lab-01-01234567/ot/*/run/cancel", True),
        (
            "unauthorized",
            "Declare/Undeclare Liveliness Token (ingress)",
            "ot/alice/run/alive",
            True,
        ),
        ("unauthorized", "Query (ingress)", "ot/bob/run/alive", False),
        (
            "unauthorized",
            "Query (egress)",
            "ss/lab-01-01234567/ot/alice/run/cancel",
            False,
        ),
        ("authorized", "Query (ingress)", "ss/lab-01-01234567/ot/bob/run/cancel", False),
        (
            "unauthorized",
            "Put (ingress)",
            "ss/lab-01-01234567/ot/alice/run/cancel",
            False,
        ),
    ],
)
def test_a_request_in_anothers_name_is_reported(
    verdict: str, what: str, key: str, told: bool
) -> None:
    assert refusals.posed_as(DENIED.format(verdict, what, key)) == (
        ("ot.bob", f"zswarm/v1/default/{key}") if told else None
    )
