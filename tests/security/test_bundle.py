"""A bundle's parts belong together, or it is refused in one line."""

import os
import stat
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.lab_keys import LONG_AGO, NOW, TOMORROW, again, authority, issued, of
from zswarm.errors import KeysError
from zswarm.security import bundle, certificates

FUZZ = settings(
    derandomize=True,
    max_examples=200 if os.environ.get("CI") else 50,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


def refusal(path: Path, content: certificates.Bundle) -> str:
    bundle.write(path, content)
    with pytest.raises(KeysError) as refused:
        bundle.read(path)
    assert str(refused.value).isprintable()
    return str(refused.value)


@pytest.fixture
def pair(tmp_path: Path) -> tuple[certificates.Bundle, certificates.Bundle]:
    first, second = issued(tmp_path / "authority", of("ss", "lab-01"), of("ot", "alice"))
    return first, second


def test_a_bundle_with_a_key_is_its_owners_alone(
    tmp_path: Path, pair: tuple[certificates.Bundle, certificates.Bundle]
) -> None:
    before = os.umask(0)
    try:
        bundle.write(tmp_path / "lab-01.zkeys", pair[0])
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "lab-01.zkeys").stat().st_mode) == 0o600
    checked = bundle.read(tmp_path / "lab-01.zkeys")
    assert checked.holder is not None
    assert checked.holder == of("ss", "lab-01")


def test_a_bundle_without_a_certificate_is_a_list_of_members(tmp_path: Path) -> None:
    issued(tmp_path / "authority", of("ss", "lab-01"))
    with again(tmp_path / "authority", NOW) as made:
        bundle.write(tmp_path / "members.zkeys", made.list_of_members())
    checked = bundle.read(tmp_path / "members.zkeys")
    assert checked.holder is None
    assert checked.members.servers == ["lab-01"]
    assert "PRIVATE KEY" not in (tmp_path / "members.zkeys").read_text()


def test_parts_of_two_bundles_are_refused(
    tmp_path: Path, pair: tuple[certificates.Bundle, certificates.Bundle]
) -> None:
    first, second = pair
    (theirs,) = issued(tmp_path / "other", of("ss", "lab-01"))
    for changes, text in (
        ({"key": second.key}, "key.pem: not the key of the certificate next to it"),
        ({"certificate": ""}, "key.pem: not the key of the certificate next to it"),
        ({"certificate": theirs.certificate}, "the certificate is of another authority"),
        ({"members": theirs.members}, "the list of another authority"),
        ({"authority": theirs.authority}, "the list of another authority"),
        ({"authority": first.certificate}, "not the certificate of an authority"),
        ({"authority": ""}, "no certificate in PEM"),
        ({"key": "x"}, "no private key in PEM"),
        (
            {"members": msgspec.structs.replace(first.members, signature="")},
            "did not sign this list",
        ),
        (
            {"members": msgspec.structs.replace(first.members, signature="\u202e")},
            "did not sign this list",
        ),
    ):
        assert text in refusal(
            tmp_path / "x.zkeys", msgspec.structs.replace(first, **changes)
        )


def test_a_holder_that_is_not_a_member_is_refused(
    tmp_path: Path, pair: tuple[certificates.Bundle, certificates.Bundle]
) -> None:
    with again(tmp_path / "authority", NOW) as made:
        made.revoke(["lab-01"])
        later = msgspec.structs.replace(pair[0], members=made.members())
    assert "the server lab-01 is not, or no longer, among the members" in refusal(
        tmp_path / "x.zkeys", later
    )


def test_an_expired_bundle_is_refused(tmp_path: Path) -> None:
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"), now=LONG_AGO)
    assert "expired on" in refusal(tmp_path / "x.zkeys", content)


def test_a_bundle_that_is_not_yet_valid_is_refused(tmp_path: Path) -> None:
    with authority(tmp_path / "authority"):
        pass
    (content,) = issued(tmp_path / "authority", of("ss", "lab-01"), now=TOMORROW)
    assert "set the clock" in refusal(tmp_path / "x.zkeys", content)


@pytest.mark.parametrize("name", ["*", "a/b", "\x1b[31m", "x" * 55, "", "x\n"])
def test_an_invalid_name_is_refused_even_if_signed(
    tmp_path: Path, pair: tuple[certificates.Bundle, certificates.Bundle], name: str
) -> None:
    members = msgspec.structs.replace(pair[0].members.members, users=[name])
    signed = msgspec.structs.replace(pair[0].members, members=members)
    assert "not a bundle of zswarm-keys, or not whole" in refusal(
        tmp_path / "x.zkeys", msgspec.structs.replace(pair[0], members=signed)
    )


@FUZZ
@given(st.binary(max_size=200))
def test_any_bytes_are_refused(tmp_path: Path, body: bytes) -> None:
    (tmp_path / "any.zkeys").write_bytes(body)
    with pytest.raises(KeysError) as refused:
        bundle.read(tmp_path / "any.zkeys")
    assert str(refused.value).isprintable()


JSON = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(allow_nan=False, allow_infinity=False),
        st.text(max_size=8),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.text(max_size=6), inner, max_size=3),
    ),
)


@FUZZ
@given(st.data())
def test_any_value_in_a_bundle_is_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    mapping = msgspec.to_builtins(of_lab_01(tmp_path_factory))
    table = data.draw(
        st.sampled_from([mapping, mapping["members"], mapping["members"]["members"]])
    )
    table[data.draw(st.one_of(st.sampled_from(sorted(table)), st.text(max_size=6)))] = (
        data.draw(JSON)
    )
    path = tmp_path_factory.getbasetemp() / "any.zkeys"
    path.write_bytes(msgspec.json.encode(mapping))
    with_key = mapping.get("key") == "" and len(mapping) == 5
    try:
        bundle.read(path)
    except KeysError as error:
        refused = str(error)
    else:
        assert with_key or mapping == msgspec.to_builtins(of_lab_01(tmp_path_factory))
        return
    assert refused.isprintable()


@FUZZ
@given(st.integers(0, 2200), st.binary(max_size=8), st.integers(0, 8))
def test_a_damaged_bundle_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, place: int, put: bytes, lost: int
) -> None:
    body = msgspec.json.encode(of_lab_01(tmp_path_factory))
    path = tmp_path_factory.getbasetemp() / "any.zkeys"
    path.write_bytes(body[:place] + put + body[place + lost :])
    refused = ""
    try:
        bundle.read(path)
    except KeysError as error:
        refused = str(error)
    assert refused.isprintable()


@pytest.mark.parametrize(
    "body",
    [b"[" * 100_000, b'{"a":' * 100_000, b"\0" * (2 << 20), b"\xff\xfe", b"null", b'"x"'],
)
def test_extreme_files_are_refused(tmp_path: Path, body: bytes) -> None:
    (tmp_path / "x.zkeys").write_bytes(body)
    with pytest.raises(KeysError):
        bundle.read(tmp_path / "x.zkeys")


made: list[certificates.Bundle] = []


def of_lab_01(factory: pytest.TempPathFactory) -> certificates.Bundle:
    """Return one bundle for all examples."""
    if not made:
        made.extend(issued(factory.mktemp("lab") / "authority", of("ss", "lab-01")))
    return made[0]
