"""Installed keys are whole, valid now and of a member, or refused in one line that says why."""

import base64
import os
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.lab_keys import (
    ALL,
    LONG_AGO,
    NOW,
    TOMORROW,
    again,
    authority,
    installed,
    issued,
    of,
    unpacked,
)
from zswarm.errors import KeysError
from zswarm.security import certificates, keyring
from zswarm.security.members import Role, SignedMembers

FUZZ = settings(
    derandomize=True,
    max_examples=150 if os.environ.get("CI") else 50,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
FILES = ("authority.pem", "certificate.pem", "key.pem", "members.json")


@pytest.fixture(autouse=True)
def no_keys_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyring, "SYSTEM", tmp_path / "etc")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delenv("ZSWARM_KEYS", raising=False)


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """The keys of the server lab-01."""
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    return installed(tmp_path / "keys", content)


def refusal(folder: Path, role: str = "ss") -> str:
    with pytest.raises(KeysError) as refused:
        keyring.load(folder, role)
    text = str(refused.value)
    assert text.isprintable()
    assert str(folder) in text
    return text


@pytest.mark.parametrize("role", ALL)
def test_installed_keys_show_holder_and_members(tmp_path: Path, role: Role) -> None:
    holders = [of(each, name) for each, name in ALL.items()]
    content = dict(zip(ALL, issued(tmp_path / "authority", *holders), strict=True))[role]
    loaded = keyring.load(installed(tmp_path / "keys", content), role)
    assert (loaded.role, loaded.name, loaded.folder) == (
        role,
        ALL[role],
        tmp_path / "keys",
    )
    assert (loaded.members.servers, loaded.members.users, loaded.members.routers) == (
        ["lab-01"],
        ["alice"],
        ["gate"],
    )
    assert loaded.authority == loaded.members.authority
    assert 364 <= (loaded.not_after - NOW).days <= 366


@pytest.mark.parametrize("file", FILES)
def test_a_missing_file_is_named(lab: Path, file: str) -> None:
    (lab / file).unlink()
    assert (
        "missing" in refusal(lab)
        if file != "certificate.pem"
        else "no keys are installed here" in refusal(lab)
    )


@pytest.mark.parametrize("file", FILES)
def test_a_damaged_file_is_named(lab: Path, file: str) -> None:
    (lab / file).write_bytes((lab / file).read_bytes()[:-40])
    assert f"{lab}/{file}" in refusal(lab)


@pytest.mark.parametrize("file", FILES)
def test_reading_special_files_does_not_block(lab: Path, file: str) -> None:
    (lab / file).unlink()
    os.mkfifo(lab / file, 0o600)
    assert "not a file" in refusal(lab)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o644])
def test_a_key_that_others_may_read_is_refused(lab: Path, mode: int) -> None:
    (lab / "key.pem").chmod(mode)
    assert f"(mode {mode:o}): chmod 600 it" in refusal(lab)


def test_a_key_of_another_certificate_is_refused(tmp_path: Path) -> None:
    first, second = issued(tmp_path / "authority", of("ss", "lab-01"), of("ss", "lab-02"))
    folder = unpacked(tmp_path / "keys", msgspec.structs.replace(first, key=second.key))
    assert "key.pem: not the key of the certificate next to it" in refusal(folder)


def test_a_certificate_of_another_authority_is_refused(tmp_path: Path) -> None:
    (mine,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    (theirs,) = issued(tmp_path / "other", of("ss", "lab-01"))
    folder = unpacked(
        tmp_path / "keys",
        msgspec.structs.replace(mine, certificate=theirs.certificate, key=theirs.key),
    )
    assert "certificate.pem: the certificate is of another authority" in refusal(folder)


def test_a_holders_certificate_is_not_accepted_as_authority(tmp_path: Path) -> None:
    (mine,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    folder = unpacked(
        tmp_path / "keys", msgspec.structs.replace(mine, authority=mine.certificate)
    )
    assert "authority.pem: not the certificate of an authority" in refusal(folder)


def test_a_self_signed_certificate_is_not_accepted_as_authority(tmp_path: Path) -> None:
    (mine,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "ss.lab-01")])
    key = certificates.new_key()
    builder = x509.CertificateBuilder(
        name, name, key.public_key(), 1, NOW - timedelta(days=1), NOW + timedelta(days=1)
    )
    for constraints in ([], [x509.BasicConstraints(ca=False, path_length=None)]):
        for extension in constraints:
            builder = builder.add_extension(extension, critical=True)
        pem = (
            builder.sign(key, certificates.HASH())
            .public_bytes(serialization.Encoding.PEM)
            .decode()
        )
        folder = tmp_path / f"keys-{len(constraints)}"
        unpacked(folder, msgspec.structs.replace(mine, authority=pem, certificate=pem))
        assert "authority.pem: not the certificate of an authority" in refusal(folder)


def test_contents_that_the_library_only_warns_about_are_refused(tmp_path: Path) -> None:
    """Such as a serial number below 0: one line, no warning on the terminal."""
    (mine,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    der = bytearray(
        x509.load_pem_x509_certificate(mine.certificate.encode()).public_bytes(
            serialization.Encoding.DER
        )
    )
    # Behind the version: the serial number's first byte.
    at = der.index(bytes.fromhex("a003020102")) + 7
    der[at] |= 0x80
    text = base64.encodebytes(bytes(der)).decode()
    changed = f"-----BEGIN CERTIFICATE-----\n{text}-----END CERTIFICATE-----\n"
    folder = unpacked(
        tmp_path / "keys", msgspec.structs.replace(mine, certificate=changed)
    )
    assert "certificate.pem: no certificate in PEM: damaged, or another file" in refusal(
        folder
    )


def test_keys_of_another_kind_are_refused(tmp_path: Path) -> None:
    """A key of another curve is refused in an authority's certificate and as a key."""
    (mine,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    key = ec.generate_private_key(ec.SECP384R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "authority.lab")])
    builder = x509.CertificateBuilder(
        name, name, key.public_key(), 1, NOW - timedelta(days=1), NOW + timedelta(days=1)
    )
    pem = (
        builder.sign(key, certificates.HASH())
        .public_bytes(serialization.Encoding.PEM)
        .decode()
    )
    first = unpacked(tmp_path / "first", msgspec.structs.replace(mine, authority=pem))
    assert "authority.pem: the certificate's key is not EC P-256" in refusal(first)
    second = unpacked(
        tmp_path / "second",
        msgspec.structs.replace(mine, key=certificates.key_pem(key).decode()),
    )
    assert "key.pem: the key is not EC P-256" in refusal(second)


def test_an_expired_certificate_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"), now=LONG_AGO)
    text = refusal(unpacked(tmp_path / "keys", content))
    assert "the certificate of the server lab-01 expired on" in text
    assert "zswarm-keys renew lab-01" in text


def test_a_certificate_that_is_not_yet_valid_is_refused_with_the_clock(
    tmp_path: Path,
) -> None:
    with authority(tmp_path / "authority"):
        pass
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"), now=TOMORROW)
    text = refusal(unpacked(tmp_path / "keys", content))
    assert "is valid from" in text
    assert "set the clock" in text


def test_a_clock_that_is_four_minutes_late_does_not_matter(tmp_path: Path) -> None:
    (content,) = issued(
        tmp_path / "authority", of("ss", "lab-01"), now=NOW + timedelta(minutes=4)
    )
    assert keyring.load(installed(tmp_path / "keys", content), "ss").name == "lab-01"


@pytest.mark.parametrize("needed", [role for role in ALL if role != "ss"])
def test_keys_of_another_role_are_refused(lab: Path, needed: str) -> None:
    text = refusal(lab, needed)
    assert "these are the keys of the server lab-01" in text
    assert f"{keyring.PROGRAMS[needed]} needs those of a" in text


def members(folder: Path) -> SignedMembers:
    return msgspec.json.decode((folder / "members.json").read_bytes(), type=SignedMembers)


def test_a_changed_list_of_members_is_refused(lab: Path) -> None:
    signed = members(lab)
    for changes in (
        {"users": ["mallory"]},
        {"number": 99},
        {"servers": ["lab-01", "lab-99"]},
    ):
        changed = msgspec.structs.replace(
            signed, members=msgspec.structs.replace(signed.members, **changes)
        )
        (lab / "members.json").write_bytes(msgspec.json.encode(changed))
        assert "the authority did not sign this list, or it was changed since" in refusal(
            lab
        )


def test_the_list_of_another_authority_is_refused(tmp_path: Path, lab: Path) -> None:
    (theirs,) = issued(tmp_path / "other", of("ss", "lab-01"))
    (lab / "members.json").write_bytes(msgspec.json.encode(theirs.members))
    assert "the list of another authority" in refusal(lab)


def test_a_revoked_holder_is_refused(tmp_path: Path, lab: Path) -> None:
    with again(tmp_path / "authority", TOMORROW) as opened:
        opened.revoke(["lab-01"])
        (lab / "members.json").write_bytes(msgspec.json.encode(opened.members()))
    assert (
        "the server lab-01 is not, or no longer, among the members (list 3): it was revoked"
        in refusal(lab)
    )


def test_a_name_of_another_role_gives_no_access(tmp_path: Path) -> None:
    """A user alice is no server alice."""
    server, _ = issued(tmp_path / "authority", of("ss", "lab-01"), of("ot", "alice"))
    _, user = issued(tmp_path / "other", of("ss", "alice"), of("ot", "bob"))
    assert server.members.members.servers == ["lab-01"]
    assert user.members.members.users == ["bob"]


# ---- where they are


def test_without_installed_keys_none_are_found() -> None:
    assert keyring.find() is None


def test_the_given_folder_comes_first_then_the_environment_then_the_system_then_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"))
    mine = unpacked(tmp_path / "config/zswarm/keys", content)
    assert keyring.find() == mine
    unpacked(tmp_path / "etc", content)
    assert keyring.find() == tmp_path / "etc"
    monkeypatch.setenv("ZSWARM_KEYS", "/environment")
    assert keyring.find() == Path("/environment")
    assert keyring.find("/given") == Path("/given")


def test_a_pending_request_is_not_an_installed_key(tmp_path: Path) -> None:
    folder = tmp_path / "config/zswarm/keys"
    folder.mkdir(parents=True)
    (folder / "request.pem").touch(0o600)
    assert keyring.find() is None
    assert "no keys are installed here" in refusal(folder)


def hidden(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    """Folders that this user may not enter; root may enter any."""
    stat = Path.stat

    def refusing(self: Path, **options: bool) -> os.stat_result:
        if self.parent in folders:
            raise PermissionError(13, "Permission denied", str(self))
        return stat(self, **options)

    monkeypatch.setattr(Path, "stat", refusing)


def test_a_users_own_keys_come_before_the_systems_that_it_may_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (content,) = issued(tmp_path / "authority", of("ot", "alice"))
    mine = unpacked(tmp_path / "config/zswarm/keys", content)
    (tmp_path / "etc").mkdir()
    hidden(monkeypatch, tmp_path / "etc")
    assert keyring.find() == mine


def test_keys_that_may_not_be_read_are_found_and_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that may not read the system's keys does not continue unencrypted."""
    (tmp_path / "etc").mkdir()
    hidden(monkeypatch, tmp_path / "etc")
    found = keyring.find()
    assert found == tmp_path / "etc"
    refusal(found)


# ---- any bytes


@FUZZ
@given(st.sampled_from(FILES), st.binary(max_size=200))
def test_any_bytes_are_refused(
    tmp_path_factory: pytest.TempPathFactory, file: str, body: bytes
) -> None:
    folder = tmp_path_factory.getbasetemp() / "any-bytes"
    if not folder.exists():
        (content,) = issued(
            tmp_path_factory.mktemp("any") / "authority", of("ss", "lab-01")
        )
        installed(folder, content)
    before = (folder / file).read_bytes()
    (folder / file).write_bytes(body)
    try:
        refusal(folder)
    finally:
        (folder / file).write_bytes(before)
    assert keyring.load(folder, "ss").name == "lab-01"


@FUZZ
@given(
    st.sampled_from(["authority.pem", "certificate.pem", "key.pem"]),
    st.integers(0, 480),
    st.binary(max_size=4),
    st.integers(0, 4),
)
def test_damage_within_the_pem_is_accepted_or_refused(
    tmp_path_factory: pytest.TempPathFactory, file: str, place: int, put: bytes, lost: int
) -> None:
    """It reaches the reading of certificates and keys."""
    folder = tmp_path_factory.getbasetemp() / "within"
    if not folder.exists():
        (content,) = issued(
            tmp_path_factory.mktemp("any") / "authority", of("ss", "lab-01")
        )
        installed(folder, content)
    before = (folder / file).read_text()
    first, *lines, last = before.splitlines()
    body = base64.b64decode("".join(lines))
    text = base64.encodebytes(body[:place] + put + body[place + lost :]).decode()
    (folder / file).write_text(f"{first}\n{text}{last}\n")
    refused = ""
    try:
        keyring.load(folder, "ss")
    except KeysError as error:
        refused = str(error)
    finally:
        (folder / file).write_text(before)
    assert refused.isprintable()


@FUZZ
@given(
    st.sampled_from(FILES), st.integers(0, 900), st.binary(max_size=8), st.integers(0, 8)
)
def test_damaged_files_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, file: str, place: int, put: bytes, lost: int
) -> None:
    folder = tmp_path_factory.getbasetemp() / "damaged"
    if not folder.exists():
        (content,) = issued(
            tmp_path_factory.mktemp("any") / "authority", of("ss", "lab-01")
        )
        installed(folder, content)
    before = (folder / file).read_bytes()
    (folder / file).write_bytes(before[:place] + put + before[place + lost :])
    refused = ""
    try:
        assert keyring.load(folder, "ss").name == "lab-01"
    except KeysError as error:
        refused = str(error)
    finally:
        (folder / file).write_bytes(before)
    assert refused.isprintable()


def damaging() -> list[Callable[[bytes], bytes]]:
    return [
        lambda _: b"[" * 100_000,
        lambda _: b"\0" * (2 << 20),
        lambda body: body + body,
        lambda _: b"",
        lambda _: b"{}",
    ]


@pytest.mark.parametrize(
    "damage", damaging(), ids=["deep", "large", "twice", "empty", "nothing"]
)
def test_extreme_files_are_refused(lab: Path, damage: Callable[[bytes], bytes]) -> None:
    for file in ("authority.pem", "members.json"):
        before = (lab / file).read_bytes()
        (lab / file).write_bytes(damage(before))
        # Of several certificates the first one counts.
        if not (file.endswith("pem") and damage(b"x") == b"xx"):
            assert file in refusal(lab)
        (lab / file).write_bytes(before)
