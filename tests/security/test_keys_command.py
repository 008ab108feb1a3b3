"""``zswarm-keys``: the life of a lab's keys, and one line that helps for every mistake."""

import json
import os
import platform
import stat
import subprocess
import sys
from datetime import timedelta
from pathlib import Path

import click
import pytest

from tests.lab_keys import NOW, Machine, again
from zswarm.errors import KeysError
from zswarm.security import authority, cli, install, keyring
from zswarm.system.extras import how

LAB = [f"lab-{number:02}" for number in range(1, 21)]


@pytest.fixture(autouse=True)
def no_service_on_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The user of the service may be there, and keys of the system."""
    monkeypatch.setattr(keyring, "SYSTEM", tmp_path / "etc")
    monkeypatch.setattr(install, "SERVICE_USER", "nobody-has-this-name")


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """The administrator's machine, with an authority; files are written to its folder."""
    desk = Machine(tmp_path / "desk")
    monkeypatch.chdir(desk.folder)
    desk.works("init", "--name", "lab")
    return desk


def machine(tmp_path: Path, name: str) -> Machine:
    return Machine(tmp_path / name)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


# ---- as it is meant


def test_keys_are_issued_for_twenty_machines_and_a_person(
    tmp_path: Path, desk: Machine
) -> None:
    told = desk.works(
        "issue",
        *LAB,
        "--optimizer",
        "alice",
        "--router",
        "gate",
        "--address",
        "lab-01=10.0.0.5",
    )
    assert sorted(path.name for path in desk.folder.glob("*.zkeys")) == sorted(
        f"{name}.zkeys" for name in [*LAB, "alice", "gate", "members"]
    )
    assert (
        "lab-01.zkeys: the server lab-01. There: sudo zswarm-keys join lab-01.zkeys"
        in told
    )
    assert "alice.zkeys: the user alice. There: zswarm-keys join alice.zkeys" in told
    fingerprint = desk.status()["authority"]["fingerprint"]
    for name, role in ((LAB[0], "ss"), ("alice", "ot"), ("gate", "router")):
        there = machine(tmp_path, name)
        file = (desk.folder / f"{name}.zkeys").rename(there.folder / f"{name}.zkeys")
        assert mode(file) == 0o600
        told = there.works(
            "join", file, *(["--name", name] if role == "ss" else []), answer="y\n"
        )
        assert fingerprint in told
        assert not file.exists(), "it held a key"
        assert mode(there.keys) == 0o700
        assert mode(there.keys / "key.pem") == 0o600
        loaded = keyring.load(there.keys, role)
        assert (loaded.name, loaded.authority, loaded.members.servers) == (
            name,
            fingerprint,
            LAB,
        )
        installed = there.status()["installed"]
        assert (
            installed["role"],
            installed["name"],
            installed["state"],
            installed["error"],
        ) == (
            role,
            name,
            "valid",
            None,
        )


def test_a_server_named_as_its_host_needs_no_name(
    tmp_path: Path, desk: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "node", lambda: "Lab-01.uni.edu")
    desk.works("issue", "lab-01")
    desk.works("join", "lab-01.zkeys", "--yes")
    assert keyring.load(desk.keys, "ss").name == "lab-01"


def test_without_confirmation_nothing_is_installed(desk: Machine) -> None:
    desk.works("issue", "--optimizer", "alice")
    assert desk.refuses("join", "alice.zkeys", answer="n\n") == "nothing was installed"
    assert not desk.keys.exists()
    assert (desk.folder / "alice.zkeys").exists()


def test_a_person_and_a_machine_are_added_and_revoked(
    tmp_path: Path, desk: Machine
) -> None:
    """The list of members that comes with the news is installed where keys are already."""
    desk.works("issue", "lab-01", "--optimizer", "alice")
    lab_01 = machine(tmp_path, "lab-01")
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    desk.works("issue", "lab-02", "--optimizer", "bob")
    first = (desk.folder / "members.zkeys").read_bytes()
    told = lab_01.works("join", "members.zkeys")
    assert "installed list 3" in told
    assert "reload zswarm-ss, or SIGHUP to it" in told
    assert keyring.load(lab_01.keys, "ss").members.users == ["alice", "bob"]
    told = desk.works("revoke", "alice")
    assert "members.zkeys: list 4 of members" in told
    lab_01.works("join", "members.zkeys")
    assert keyring.load(lab_01.keys, "ss").members.users == ["bob"]
    assert "is installed in" in lab_01.works("join", "members.zkeys"), "again"
    (desk.folder / "members.zkeys").write_bytes(first)
    assert "this is list 3, older than list 4" in lab_01.refuses("join", "members.zkeys")
    assert keyring.load(lab_01.keys, "ss").members.users == ["bob"]


def test_a_bundle_does_not_restore_an_older_list(tmp_path: Path, desk: Machine) -> None:
    desk.works("issue", "lab-01", "--optimizer", "alice")
    lab_01 = machine(tmp_path, "lab-01")
    bundle = (desk.folder / "lab-01.zkeys").read_bytes()
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    desk.works("revoke", "alice")
    lab_01.works("join", "members.zkeys")
    (desk.folder / "lab-01.zkeys").write_bytes(bundle)
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    assert keyring.load(lab_01.keys, "ss").members.users == []


def test_a_revoked_holder_cannot_join_with_the_new_list(
    tmp_path: Path, desk: Machine
) -> None:
    desk.works("issue", "lab-01", "lab-02")
    lab_01 = machine(tmp_path, "lab-01")
    bundle = (desk.folder / "lab-01.zkeys").read_bytes()
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    desk.works("revoke", "lab-01")
    assert (
        "the server lab-01 is not, or no longer, among the members (list 3)"
        in lab_01.refuses("join", "members.zkeys")
    )
    (desk.folder / "lab-01.zkeys").write_bytes(bundle)
    assert "it was revoked" in lab_01.refuses(
        "join", "lab-01.zkeys", "--name", "lab-01", "--yes"
    )


def test_keys_are_renewed(tmp_path: Path, desk: Machine) -> None:
    desk.works("issue", "lab-01", "--address", "lab-01=10.0.0.5", "--days", "20")
    lab_01 = machine(tmp_path, "lab-01")
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    before = keyring.load(lab_01.keys, "ss")
    (entry,) = desk.status()["authority"]["issued"]
    assert entry["state"] == "19 days left"
    assert lab_01.status()["installed"]["state"] == "19 days left"
    assert "Next: zswarm-keys renew lab-01" in desk.works("status")
    desk.works("renew", "lab-01")
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    after = keyring.load(lab_01.keys, "ss")
    assert after.not_after - before.not_after > timedelta(days=340)
    (entry,) = desk.status()["authority"]["issued"]
    assert (entry["state"], entry["names"][-1]) == ("valid", "10.0.0.5")


def test_a_request_keeps_the_private_key_on_its_machine(
    tmp_path: Path, desk: Machine
) -> None:
    lab_01 = machine(tmp_path, "lab-01")
    told = lab_01.works("request", "--name", "lab-01", "--address", "10.0.0.5")
    assert "zswarm-keys sign lab-01.zrequest" in told
    assert mode(lab_01.keys / "request.pem") == 0o600
    key = (lab_01.keys / "request.pem").read_text()
    assert "lab-01, lab-01.local, localhost, 127.0.0.1, 10.0.0.5" in desk.works(
        "sign", "lab-01.zrequest", answer="y\n"
    )
    assert "PRIVATE" not in (desk.folder / "lab-01.zkeys").read_text()
    elsewhere = machine(tmp_path, "elsewhere")
    assert "does not hold it" in elsewhere.refuses(
        "join", "lab-01.zkeys", "--name", "lab-01", "--yes"
    )
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    assert sorted(os.listdir(lab_01.keys)) == [
        "authority.pem",
        "certificate.pem",
        "key.pem",
        "members.json",
    ]
    assert keyring.load(lab_01.keys, "ss").name == "lab-01"
    desk.works("renew", "lab-01")
    lab_01.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    assert (lab_01.keys / "key.pem").read_text() == key


def test_keys_of_users_and_routers_may_also_stay_on_their_machines(
    tmp_path: Path, desk: Machine
) -> None:
    for role, arguments in (
        ("ot", ["--optimizer", "alice"]),
        ("router", ["--router", "--name", "alice-gate"]),
    ):
        there = machine(tmp_path, role)
        there.works("request", *arguments)
        name = arguments[-1]
        desk.works("sign", f"{name}.zrequest", "--yes")
        there.works("join", f"{name}.zkeys", "--yes")
        assert keyring.load(there.keys, role).name == name


def test_a_declined_request_is_not_signed(desk: Machine) -> None:
    desk.works("request", "--name", "lab-01")
    assert desk.refuses("sign", "lab-01.zrequest", answer="n\n") == "nothing was signed"
    assert desk.status()["authority"]["issued"] == []


def test_written_files_are_listed_in_json(desk: Machine) -> None:
    told = json.loads(desk.works("issue", "lab-01", "--json"))
    assert told["holders"] == ["ss.lab-01"]
    assert (told["files"], told["members"], told["number"]) == (
        ["lab-01.zkeys"],
        "members.zkeys",
        2,
    )
    assert (
        json.loads(desk.works("renew", "lab-01", "--force", "--json"))["members"] is None
    )
    assert json.loads(desk.works("revoke", "lab-01", "--json"))["number"] == 3
    assert desk.status()["authority"]["issued"][0]["state"] == "revoked"


def test_keys_of_the_service_belong_to_its_user(
    tmp_path: Path, desk: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When root installs them; those of a user stay root's."""
    if os.geteuid() != 0:
        pytest.skip("only root gives files away")
    monkeypatch.setattr(install, "SERVICE_USER", "nobody")
    desk.works("issue", "lab-01", "--optimizer", "alice")
    desk.works(
        "join", "lab-01.zkeys", "--name", "lab-01", "--yes", "--keys", tmp_path / "a"
    )
    owners = {
        (path.stat().st_uid, path.name)
        for path in [tmp_path / "a", *(tmp_path / "a").iterdir()]
    }
    assert len(owners) == 5
    assert {uid for uid, _ in owners} == {install.pwd.getpwnam("nobody").pw_uid}
    desk.works("issue", "lab-02")
    desk.works("join", "members.zkeys", "--keys", tmp_path / "a")
    assert (
        (tmp_path / "a" / "members.json").stat().st_uid
        == (tmp_path / "a").stat().st_uid
        != 0
    )
    desk.works("join", "alice.zkeys", "--yes", "--keys", tmp_path / "b")
    assert (tmp_path / "b" / "key.pem").stat().st_uid == 0


def test_keys_are_installed_for_the_system_by_root_and_else_for_the_user(
    desk: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.environment["ZSWARM_KEYS"] = ""
    desk.works("issue", "lab-01", "--optimizer", "alice")
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: 1000)
        desk.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
        desk.works("renew", "lab-01")
    assert keyring.load(desk.home / ".config/zswarm/keys").name == "lab-01"
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: 0)
        desk.works("join", "lab-01.zkeys", "--name", "lab-01", "--yes")
    assert keyring.load(keyring.SYSTEM).name == "lab-01"
    desk.environment["ZSWARM_KEYS"] = "none"
    desk.works("renew", "lab-01")
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: 1000)
        assert "Next: systemctl --user reload zswarm-ss" in desk.works(
            "join", "lab-01.zkeys", "--name", "lab-01", "--yes"
        )
    assert not Path("none").exists()
    desk.environment["SUDO_USER"] = "alice"
    assert "do this without sudo" in desk.refuses("join", "alice.zkeys", "--yes")


# ---- mistakes


def test_without_an_authority_its_commands_print_how_to_create_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = machine(tmp_path, "there")
    monkeypatch.chdir(there.folder)
    there.works("request", "--optimizer", "alice")
    there.environment["ZSWARM_KEYS"] = ""
    for arguments in (
        ["issue", "lab-01"],
        ["renew", "lab-01"],
        ["revoke", "lab-01"],
        ["sign", "alice.zrequest"],
    ):
        assert "no authority here; zswarm-keys init makes one" in there.refuses(
            *arguments
        )
    assert "no authority in" in there.refuses("status")
    assert "no authority here" in there.refuses("status", "--authority", "nowhere")
    assert not there.authority.exists()


def test_the_name_of_a_lab_follows_the_rules_for_holders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = machine(tmp_path, "there")
    for name in ("", "../x", "My Lab", "\x1b[31m"):
        assert "the lab's name" in there.refuses("init", "--name", name)
    assert not there.authority.exists()


def test_an_empty_name_is_refused(desk: Machine) -> None:
    for option in ("--name", "--optimizer"):
        assert "'': expected" in desk.refuses("request", option, "")


def test_a_second_authority_is_refused(desk: Machine) -> None:
    fingerprint = desk.status()["authority"]["fingerprint"]
    assert "there is an authority already" in desk.refuses("init")
    assert desk.status()["authority"]["fingerprint"] == fingerprint
    desk.works("init", "--authority", "other")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "whose keys?"),
        (["*"], "server '*': expected 1 to 54 of a-z"),
        (["../lab"], "server '../lab': expected"),
        (["Lab-01"], "lab-01 would be valid"),
        (["--optimizer", "x\x1b]0;title\x07"], "user 'x\\x1b]0;title\\x07': expected"),
        (["--router", "\u202egate"], "router '\\u202egate': expected"),
        (["lab-01", "--optimizer", "lab-01"], "lab-01 was given twice"),
        (
            ["lab-01", "--address", "lab-02=10.0.0.5"],
            "expected NAME=ADDRESS with one of the names given",
        ),
        (["lab-01", "--address", "10.0.0.5"], "expected NAME=ADDRESS"),
        (["lab-01", "--address", "lab-01=*"], "without wildcards"),
        (["lab-01", "--out", "nowhere"], "--out nowhere: no such folder"),
        (
            ["lab-01", "--out", "taken"],
            "taken/lab-01.zkeys exists already; --force replaces it",
        ),
        (["members"], "take another"),
    ],
)
def test_invalid_arguments_of_issue_are_refused_before_anything_is_issued(
    desk: Machine, arguments: list[str], said: str
) -> None:
    (desk.folder / "taken").mkdir()
    (desk.folder / "taken/lab-01.zkeys").touch()
    assert said in desk.refuses("issue", *arguments)
    assert desk.status()["authority"]["issued"] == []
    assert list(desk.folder.glob("*.zkeys")) == []


def test_a_name_issued_already_is_renewed_instead(desk: Machine) -> None:
    desk.works("issue", "lab-01")
    assert "zswarm-keys renew lab-01 makes new ones" in desk.refuses(
        "issue", "lab-01", "--force"
    )
    assert "lab-01.zkeys exists already; --force replaces it" in desk.refuses(
        "renew", "lab-01"
    )
    desk.works("renew", "lab-01", "--force")


@pytest.mark.parametrize("verb", ["revoke", "renew"])
def test_an_unknown_name_is_reported_with_the_nearest(desk: Machine, verb: str) -> None:
    desk.works("issue", "--optimizer", "alice")
    assert "no keys were issued to 'alicia' (did you mean 'alice'?)" in desk.refuses(
        verb, "alicia"
    )
    assert "no keys were issued to '\\x1b[31m'" in desk.refuses(verb, "\x1b[31m")


def test_revoking_twice_is_reported(desk: Machine) -> None:
    desk.works("issue", "--optimizer", "alice")
    desk.works("revoke", "alice", "alice")
    assert "the user alice was revoked already" in desk.refuses("revoke", "alice")


def test_a_bundle_for_another_machine_is_refused_naming_both(
    desk: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform, "node", lambda: "lab-07.uni.edu")
    desk.works("issue", "lab-01")
    said = desk.refuses("join", "lab-01.zkeys", "--yes")
    assert "the server lab-01" in said
    assert "this machine is 'lab-07'" in said
    assert "--name is 'lab-02'" in desk.refuses(
        "join", "lab-01.zkeys", "--yes", "--name", "lab-02"
    )
    assert not desk.keys.exists()


def test_keys_of_another_authority_or_holder_are_replaced_by_force_only(
    desk: Machine,
) -> None:
    desk.works("issue", "--optimizer", "alice", "--optimizer", "bob")
    desk.works("join", "alice.zkeys", "--yes")
    desk.works("init", "--authority", "other")
    desk.works("issue", "--optimizer", "alice", "--authority", "other")
    assert "holds keys of another authority" in desk.refuses(
        "join", "alice.zkeys", "--yes"
    )
    assert "this is the list of another authority" in desk.refuses(
        "join", "members.zkeys"
    )
    assert "holds the keys of ot.alice, and these are of ot.bob" in desk.refuses(
        "join", "bob.zkeys", "--yes"
    )
    desk.works("join", "bob.zkeys", "--yes", "--force")
    assert keyring.load(desk.keys, "ot").name == "bob"
    desk.works("join", "alice.zkeys", "--yes", "--force")
    assert keyring.load(desk.keys, "ot").name == "alice"


def test_damaged_keys_are_replaced_by_force_only(desk: Machine) -> None:
    desk.works("issue", "--optimizer", "alice")
    desk.works("join", "alice.zkeys", "--yes")
    (desk.keys / "certificate.pem").write_text("damaged")
    assert "not to be used" in desk.works("status")
    desk.works("renew", "alice")
    assert "--force replaces it" in desk.refuses("join", "alice.zkeys", "--yes")
    desk.works("join", "alice.zkeys", "--yes", "--force")
    assert desk.status()["installed"]["error"] is None


def test_an_interrupted_join_is_repeated(
    desk: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.works("issue", "--optimizer", "alice")
    desk.works("join", "alice.zkeys", "--yes")
    desk.works("renew", "alice")
    whole, written = install.write_whole, iter(range(2))

    def cut(path: Path, *arguments: object) -> None:
        if next(written, None) is None:
            raise OSError(28, "No space left on device", str(path))
        whole(path, *arguments)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(install, "write_whole", cut)
        done = desk.run("join", "alice.zkeys", "--yes")
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "No space left on device" in done.stderr
    desk.works("join", "alice.zkeys", "--yes")
    assert keyring.load(desk.keys, "ot").name == "alice"


def test_a_folder_with_other_files_is_refused_for_keys(desk: Machine) -> None:
    desk.works("issue", "--optimizer", "alice")
    assert "expected a folder for keys alone" in desk.refuses(
        "join", "alice.zkeys", "--yes", "--keys", desk.folder
    )
    assert "expected a folder for keys alone" in desk.refuses(
        "request", "--optimizer", "bob", "--keys", desk.folder
    )


def test_a_list_of_members_is_not_accepted_as_keys(tmp_path: Path, desk: Machine) -> None:
    desk.works("issue", "lab-01")
    there = machine(tmp_path, "there")
    there.environment["ZSWARM_KEYS"] = ""
    assert "no keys are installed here" in there.refuses("join", "members.zkeys")
    assert "authority.pem: missing" in there.refuses(
        "join", "members.zkeys", "--keys", "nowhere"
    )


def test_a_second_request_does_not_replace_the_first(desk: Machine) -> None:
    desk.works("request", "--optimizer", "alice")
    before = (desk.keys / "request.pem").read_bytes()
    assert "--force forgets it" in desk.refuses("request", "--optimizer", "alice")
    assert (desk.keys / "request.pem").read_bytes() == before
    desk.works("request", "--optimizer", "alice", "--force")
    assert (desk.keys / "request.pem").read_bytes() != before
    assert "leave --router and --name out" in desk.refuses(
        "request", "--optimizer", "alice", "--router"
    )


def test_a_bundle_that_others_could_read_is_installed_with_a_warning(
    desk: Machine,
) -> None:
    desk.works("issue", "--optimizer", "alice")
    (desk.folder / "alice.zkeys").chmod(0o644)
    assert "warning: others on this machine could read alice.zkeys" in desk.works(
        "join", "alice.zkeys", "--yes"
    )


def test_control_characters_of_a_file_name_are_escaped(desk: Machine) -> None:
    Path("x\x1b]0;title\x07\u202e").write_text("x")
    assert "x\\x1b]0;title\\x07\\x202e: not a bundle" in desk.refuses(
        "join", "x\x1b]0;title\x07\u202e"
    )


def test_an_authoritys_key_that_others_may_read_is_refused(desk: Machine) -> None:
    (desk.authority / "key.pem").chmod(0o644)
    assert "others than its owner may read this key (mode 644)" in desk.refuses(
        "issue", "lab-01"
    )


def test_an_authority_in_use_is_waited_for_by_the_user(desk: Machine) -> None:
    with again(desk.authority, NOW):
        assert "another zswarm-keys works on it" in desk.refuses("issue", "lab-01")


# ---- secrets


def secrets(folder: Path) -> set[str]:
    """Return the lines of all private keys in files below a folder."""
    found = set()
    for path in folder.rglob("*"):
        text = path.read_text().replace("\\n", "\n") if path.is_file() else ""
        for part in text.split("-----BEGIN PRIVATE KEY-----")[1:]:
            found |= set(part.split("-----END")[0].split())
    return found


def test_no_secret_is_printed(tmp_path: Path, desk: Machine) -> None:
    """No line of a private key is on stdout or stderr, or in a file that is not secret."""
    desk.works("issue", "lab-01", "--optimizer", "alice", "--json")
    desk.works("request", "--optimizer", "bob")
    desk.works("sign", "bob.zrequest", "--yes")
    known = secrets(tmp_path)
    assert len(known) >= 4 * 3, "authority, lab-01, alice, bob"
    desk.refuses("join", "lab-01.zkeys", "--yes")
    desk.works("join", "lab-01.zkeys", "--yes", "--name", "lab-01", "--keys", "a")
    Path("alice.zkeys").write_text(
        Path("alice.zkeys").read_text().replace('"zswarm-keys-1"', '"x"')
    )
    desk.refuses("join", "alice.zkeys", "--yes")
    desk.works("status")
    desk.works("status", "--json", "--keys", "a")
    desk.works("revoke", "alice")
    told = desk.said
    assert told
    assert not [line for line in known if line in told]
    for shown in ("members.zkeys", "bob.zrequest", "bob.zkeys"):
        assert not [line for line in known if line in Path(shown).read_text()]


def test_a_misplaced_secret_is_not_printed(desk: Machine) -> None:
    """A field that does not fit is named without what it holds."""
    desk.works("issue", "--optimizer", "alice")
    content = json.loads(Path("alice.zkeys").read_text())
    key = content["key"]
    for mapping in (
        content | {"format": key},
        content | {key: 1},
        content | {"key": [key]},
        content | {"authority": key},
    ):
        Path("x.zkeys").write_text(json.dumps(mapping))
        said = desk.refuses("join", "x.zkeys", "--yes")
        assert key.split()[3] not in said


# ---- the program


def test_the_program_has_documented_exit_codes_and_streams(tmp_path: Path) -> None:
    """The program runs as a process, and prints no traceback."""
    environment = os.environ | {
        "XDG_DATA_HOME": str(tmp_path),
        "ZSWARM_KEYS": str(tmp_path / "keys"),
    }

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "zswarm.security", *arguments],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
        )

    made = run("init", "--json")
    assert (made.returncode, made.stderr) == (0, "")
    fingerprint = json.loads(made.stdout)["fingerprint"]
    assert run("issue", "--optimizer", "alice").returncode == 0
    assert run("join", "alice.zkeys", "--yes").returncode == 0
    shown = json.loads(run("status", "--json").stdout)
    assert (
        shown["installed"]["fingerprint"]
        == shown["authority"]["fingerprint"]
        == fingerprint
    )
    mistake = run("join", "nothing.zkeys")
    assert (mistake.returncode, mistake.stdout) == (2, "")
    assert mistake.stderr == "zswarm-keys: nothing.zkeys: missing\n"
    asked = run("issue", "--optimizer", "bob")
    assert asked.returncode == 0
    assert run("join", "bob.zkeys", "--keys", "b").returncode == 1, "nobody answers"
    assert Path(tmp_path / "bob.zkeys").exists()


def test_a_missing_cryptography_package_is_reported_with_a_fix(tmp_path: Path) -> None:
    """The command reports it, and so does a program that loads keys."""
    hide = "import sys; sys.modules['cryptography'] = None; "
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            hide + "from zswarm.security.cli import main; main()",
            "init",
            "--authority",
            str(tmp_path / "a"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == f"zswarm-keys: this needs the package cryptography: {how('keys')}\n"
    )
    (tmp_path / "certificate.pem").touch()
    (tmp_path / "key.pem").touch()
    load = f"keyring.load(Path({str(tmp_path)!r}), 'ss')"
    code = f"{hide}from pathlib import Path; from zswarm.security import keyring; {load}"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (
        f"keys need the package cryptography: {how('keys')}"
        in done.stderr.splitlines()[-1]
    )


def test_no_option_takes_a_secret() -> None:
    """Arguments are seen by everyone on a machine."""
    names = {
        option.name
        for one in cli.command.commands.values()
        for option in one.params
        if isinstance(option, click.Option)
    }
    assert not {
        name
        for name in names
        if name and ("pass" in name or "secret" in name or name == "key")
    }


def test_a_folder_without_an_authority_is_refused(tmp_path: Path) -> None:
    with pytest.raises(KeysError, match="no authority here"):
        authority.Authority(tmp_path)
