"""The authority records what it issued, gives a name once, and certifies what was requested."""

import base64
import hashlib
import json
import os
import stat
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import ExtendedKeyUsageOID
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.lab_keys import LONG_AGO, NOW, TOMORROW, again, authority, issued, of
from zswarm.errors import ConfigError, KeysError
from zswarm.security import certificates, ledger
from zswarm.security.members import new_holder
from zswarm.security.requests import alternative_names, make_request, read_request


def certificate(content: certificates.Bundle) -> x509.Certificate:
    return x509.load_pem_x509_certificate(content.certificate.encode())


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_the_authoritys_key_and_folder_are_its_owners_alone(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        with authority(tmp_path / "a" / "authority"):
            pass
    finally:
        os.umask(before)
    assert (
        mode(tmp_path / "a" / "authority"),
        mode(tmp_path / "a" / "authority" / "key.pem"),
    ) == (
        0o700,
        0o600,
    )


def test_the_fingerprint_is_160_bits_of_the_certificates_hash(tmp_path: Path) -> None:
    with authority(tmp_path / "authority") as made:
        der = made.certificate.public_bytes(serialization.Encoding.DER)
        text = base64.b32encode(hashlib.sha256(der).digest()[:20]).decode()
        assert made.fingerprint.replace("-", "") == text
        assert [len(group) for group in made.fingerprint.split("-")] == [4] * 8


def test_an_authority_lasts_five_years_and_signs_no_other(tmp_path: Path) -> None:
    with authority(tmp_path / "authority") as made:
        constraints = made.certificate.extensions.get_extension_for_class(
            x509.BasicConstraints
        )
        assert constraints.critical
        assert (constraints.value.ca, constraints.value.path_length) == (True, 0)
        assert (made.certificate.not_valid_after_utc - NOW).days in (1824, 1825)


def test_a_second_authority_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    with authority(tmp_path / "authority") as made:
        first = made.fingerprint
    with pytest.raises(KeysError, match="there is an authority already"):
        authority(tmp_path / "authority")
    assert again(tmp_path / "authority", NOW).fingerprint == first


def test_a_folder_with_other_files_is_refused_for_an_authority(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    tmp_path.chmod(0o755)
    with pytest.raises(
        ConfigError, match=r"expected a folder for keys alone, and it holds 'thesis\.tex'"
    ):
        authority(tmp_path)
    assert mode(tmp_path) == 0o755


def test_an_authority_is_opened_by_one_program_at_a_time(tmp_path: Path) -> None:
    with (
        authority(tmp_path / "authority"),
        pytest.raises(KeysError, match="another zswarm-keys works on it"),
    ):
        again(tmp_path / "authority", NOW)
    again(tmp_path / "authority", NOW)


def test_a_certificate_names_its_holder_role_and_addresses(tmp_path: Path) -> None:
    with authority(tmp_path / "authority") as made:
        (content,) = made.issue(
            {of("ss", "lab-01"): ["10.0.0.5", "lab-01.uni.edu", "fe80::1", "10.0.0.5"]},
            365,
        )
    read = certificate(content)
    names = read.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert read.subject.rfc4514_string() == "CN=ss.lab-01"
    assert [str(name.value) for name in names] == [
        "lab-01",
        "lab-01.local",
        "localhost",
        "127.0.0.1",
        "10.0.0.5",
        "lab-01.uni.edu",
        "fe80::1",
    ]
    usages = set(read.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    assert usages == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    constraints = read.extensions.get_extension_for_class(x509.BasicConstraints)
    assert constraints.critical
    assert not constraints.value.ca
    assert abs(read.not_valid_before_utc - (NOW - timedelta(minutes=5))) < timedelta(
        hours=1
    ), "NOW is when the tests began"
    lasts = read.not_valid_after_utc - read.not_valid_before_utc
    assert abs(lasts - timedelta(days=365, minutes=5)) < timedelta(minutes=1)


def test_the_certificate_of_a_user_has_no_host_names() -> None:
    """Else a user lab-01 could pose as the server lab-01."""
    assert alternative_names(of("ot", "lab-01"), []) == ["localhost", "127.0.0.1"]


def test_no_certificate_outlasts_its_authority(tmp_path: Path) -> None:
    with authority(tmp_path / "authority", now=LONG_AGO):
        pass
    with again(tmp_path / "authority", NOW) as made:
        (content,) = made.issue({of("ss", "lab-01"): []}, 1825)
        assert (
            certificate(content).not_valid_after_utc
            == made.certificate.not_valid_after_utc
        )


@pytest.mark.parametrize(
    "name",
    [
        "",
        "Lab-01",
        "-x",
        "a/b",
        "../x",
        "*",
        "lab-*",
        "a.b",
        "lab 1",
        "x\x1b[31m",
        "\u202ex",
        "x\n",
        "x" * 55,
        "a$b",
    ],
)
def test_an_invalid_name_is_refused(name: str) -> None:
    with pytest.raises(KeysError) as refused:
        new_holder("ss", name)
    assert str(refused.value).isprintable()
    assert "expected 1 to 54 of a-z, 0-9 and -" in str(refused.value)


@pytest.mark.parametrize(
    "address",
    [
        "",
        "*",
        "*.uni.edu",
        "a b",
        "a/b",
        "10.0.0.300",
        "10.0.0.0/8",
        "x\x1b[31m",
        "\u202ex",
        "-x",
        "x" * 64,
        "x..y",
    ],
)
def test_an_invalid_address_is_refused(address: str) -> None:
    with pytest.raises(KeysError) as refused:
        alternative_names(of("ss", "lab-01"), [address])
    assert str(refused.value).isprintable()


def test_the_name_of_the_list_file_is_reserved() -> None:
    with pytest.raises(KeysError, match="take another"):
        new_holder("ot", "members")


def test_each_name_is_issued_once(tmp_path: Path) -> None:
    issued(tmp_path / "authority", of("ss", "lab-01"))
    with again(tmp_path / "authority", NOW) as made:
        with pytest.raises(
            KeysError,
            match=r"has keys already, until .*: zswarm-keys renew lab-01 makes new ones",
        ):
            made.issue({of("ss", "lab-02"): [], of("ss", "lab-01"): []}, 365)
        with pytest.raises(KeysError, match="lab-01 is the name of a server already"):
            made.issue({of("ot", "lab-01"): []}, 365)
        assert [entry.common_name for entry in made.ledger.issued] == ["ss.lab-01"]


def test_a_revoked_name_is_given_again_only_when_the_revoked_keys_have_expired(
    tmp_path: Path,
) -> None:
    """Members are let in by name: the old keys would be, too."""
    issued(tmp_path / "authority", of("ot", "alice"), days=30)
    with again(tmp_path / "authority", TOMORROW) as made:
        made.revoke(["alice"])
        with pytest.raises(
            KeysError, match=r"the revoked keys would be let in again .* such as alice-2"
        ):
            made.issue({of("ot", "alice"): []}, 365)
        with pytest.raises(KeysError, match="was revoked on"):
            made.renew(["alice"], 365)
    with again(tmp_path / "authority", NOW + timedelta(days=31)) as made:
        made.issue({of("ot", "alice"): []}, 365)
        assert made.members().members.users == ["alice"]


def test_the_list_of_members_grows_in_number_with_every_change_of_it(
    tmp_path: Path,
) -> None:
    with authority(tmp_path / "authority") as made:
        numbers = [made.members().members.number]
        made.issue(
            {of("ss", "lab-01"): [], of("ss", "lab-02"): [], of("ot", "alice"): []}, 365
        )
        numbers.append(made.members().members.number)
        made.revoke(["lab-01", "alice"])
        members = made.members().members
        numbers.append(members.number)
        made.renew(["lab-02"], 365)
        numbers.append(made.members().members.number)
    assert numbers == [1, 2, 3, 3]
    assert (members.servers, members.users) == (["lab-02"], [])


def test_the_ledger_records_issued_certificates(tmp_path: Path) -> None:
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    (entry,) = json.loads((tmp_path / "authority" / "issued.json").read_text())["issued"]
    read = certificate(content)
    assert (entry["common_name"], int(entry["serial"], 16)) == (
        "ss.lab-01",
        read.serial_number,
    )
    assert entry["names"] == ["lab-01", "lab-01.local", "localhost", "127.0.0.1"]
    assert entry["revoked_at"] is None


def test_the_ledger_is_written_before_keys_are_given_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ledger that cannot be written gives no keys out."""
    with authority(tmp_path / "authority") as made:

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(ledger, "write_whole", full)
        with pytest.raises(OSError, match="No space"):
            made.issue({of("ss", "lab-01"): []}, 365)


@pytest.mark.parametrize(
    "damage",
    [b"", b"{}x", b'{"number": 2, "issued": [{}]}', b"[" * 100_000, b'{"number": 0}'],
)
def test_a_damaged_ledger_is_refused(tmp_path: Path, damage: bytes) -> None:
    issued(tmp_path / "authority", of("ss", "lab-01"))
    (tmp_path / "authority" / "issued.json").write_bytes(damage)
    with pytest.raises(KeysError, match=r"issued\.json: .*: damaged"):
        again(tmp_path / "authority", NOW)


def test_a_ledger_with_an_invalid_name_is_refused(tmp_path: Path) -> None:
    issued(tmp_path / "authority", of("ss", "lab-01"))
    path = tmp_path / "authority" / "issued.json"
    path.write_text(path.read_text().replace("ss.lab-01", "ss.*"))
    with pytest.raises(KeysError, match="is not the name of a holder"):
        again(tmp_path / "authority", NOW)


def test_a_renewed_certificate_has_the_same_names_and_another_key(tmp_path: Path) -> None:
    with authority(tmp_path / "authority") as made:
        (before,) = made.issue({of("ss", "lab-01"): ["10.0.0.5"]}, 365)
        (after,) = made.renew(["lab-01"], 365)
        assert made.ledger.last()[0].names[-1] == "10.0.0.5"
        assert len(made.ledger.last()) == 1
    first, second = certificate(before), certificate(after)
    assert first.subject == second.subject
    assert first.serial_number != second.serial_number
    assert first.public_key() != second.public_key()
    assert (
        first.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        == second.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    )


def test_a_request_is_signed_and_renewed_for_its_own_key(tmp_path: Path) -> None:
    key = certificates.new_key()
    (tmp_path / "x.zrequest").write_bytes(
        make_request(of("ss", "lab-01"), ["10.0.0.5"], key)
    )
    asked = read_request(tmp_path / "x.zrequest")
    assert (asked.holder, asked.names[-1]) == (of("ss", "lab-01"), "10.0.0.5")
    with authority(tmp_path / "authority") as made:
        signed, (renewed,) = made.sign(asked, 365), made.renew(["lab-01"], 365)
        again_signed = made.sign(asked, 365)
        assert made.members().members.number == 2
        other = asked._replace(public_key=certificates.new_key().public_key())
        with pytest.raises(KeysError, match="has keys already"):
            made.sign(other, 365)
    for content in (signed, renewed, again_signed):
        assert content.key == ""
        certificates.check_fits(key, certificate(content), "")


def test_a_request_that_its_key_did_not_sign_is_refused(tmp_path: Path) -> None:
    """Otherwise a foreign public key could be certified under another name."""
    pem = make_request(of("ss", "lab-01"), [], certificates.new_key())
    der = x509.load_pem_x509_csr(pem).public_bytes(serialization.Encoding.DER)
    changed = x509.load_der_x509_csr(
        der.replace(b"ss.lab-01", b"ss.lab-02")
    ).public_bytes(serialization.Encoding.PEM)
    (tmp_path / "x.zrequest").write_bytes(changed)
    with pytest.raises(KeysError, match="not a request that zswarm-keys request made"):
        read_request(tmp_path / "x.zrequest")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"x",
        b"-----BEGIN CERTIFICATE REQUEST-----\nAAAA\n-----END CERTIFICATE REQUEST-----\n",
    ],
)
def test_a_damaged_request_is_refused(tmp_path: Path, body: bytes) -> None:
    (tmp_path / "x.zrequest").write_bytes(body)
    with pytest.raises(
        KeysError, match="not a request of zswarm-keys: damaged, or another file"
    ):
        read_request(tmp_path / "x.zrequest")


@pytest.mark.parametrize(
    ("common_name", "dialled"),
    [("ss.lab-01", "*.uni.edu"), ("ss.*", "x"), ("root", "x"), ("ot.members", "x")],
)
def test_a_request_made_by_another_program_is_checked(
    tmp_path: Path, common_name: str, dialled: str
) -> None:
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, common_name)])
    names = x509.SubjectAlternativeName([x509.DNSName(dialled)])
    request = x509.CertificateSigningRequestBuilder(subject).add_extension(
        names, critical=False
    )
    signed = request.sign(certificates.new_key(), certificates.HASH())
    (tmp_path / "x.zrequest").write_bytes(signed.public_bytes(serialization.Encoding.PEM))
    with pytest.raises(KeysError) as refused:
        read_request(tmp_path / "x.zrequest")
    assert str(refused.value).isprintable()


@settings(
    derandomize=True,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.integers(0, 420), st.binary(max_size=8), st.integers(0, 8))
def test_a_damaged_request_is_read_or_refused(
    tmp_path: Path, place: int, put: bytes, lost: int
) -> None:
    """The damage is in the DER within the PEM, so that it reaches what is read."""
    pem = make_request(of("ss", "lab-01"), ["10.0.0.5"], certificates.new_key())
    body = x509.load_pem_x509_csr(pem).public_bytes(serialization.Encoding.DER)
    text = base64.encodebytes(body[:place] + put + body[place + lost :]).decode()
    path = tmp_path / "x.zrequest"
    path.write_text(
        f"-----BEGIN CERTIFICATE REQUEST-----\n{text}-----END CERTIFICATE REQUEST-----\n"
    )
    refused = ""
    try:
        read_request(path)
    except KeysError as error:
        refused = str(error)
    assert refused.isprintable()


def test_ambiguous_server_names_are_refused(tmp_path: Path) -> None:
    """Access rules let a server speak as its name, - and anything."""
    with authority(tmp_path / "authority") as mine:
        mine.issue({of("ss", "lab-01"): []}, 365)
        for names in (["lab"], ["lab-01-b"], ["node", "node-2"]):
            with pytest.raises(KeysError, match="could not be told apart"):
                mine.issue({of("ss", name): [] for name in names}, 365)
        mine.issue({of("ss", "lab-011"): [], of("ot", "lab"): []}, 365)
