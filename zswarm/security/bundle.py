"""Files that bring keys to a machine: ``lab-01.zkeys``.

A bundle holds the authority's certificate, the list of members, the holder's certificate, and its
key unless that never left its machine. ``members.zkeys`` holds the first two only.
"""

from pathlib import Path

import msgspec

from zswarm.config.decode import from_json
from zswarm.errors import ConfigError, KeysError
from zswarm.security import keyring
from zswarm.security.certificates import Bundle, Verified, verify
from zswarm.security.members import MEMBERS
from zswarm.system.files import write_whole

SUFFIX = ".zkeys"
MEMBERS_FILE = f"{MEMBERS}{SUFFIX}"


def write(path: Path, bundle: Bundle) -> None:
    """Write a bundle; only its owner may read one with a key."""
    body = msgspec.json.format(msgspec.json.encode(bundle)) + b"\n"
    write_whole(path, body, 0o600 if bundle.key else 0o644)


def read(path: Path) -> Verified:
    """Return a bundle that is whole, valid now, and of a member."""
    body = keyring.read(path)
    try:
        bundle = from_json(body, Bundle, str(path))
    except ConfigError:  # its text would quote what it found, which may be a key
        raise KeysError(f"{path}: not a bundle of zswarm-keys, or not whole") from None
    return verify(bundle, f"{path}: ")
