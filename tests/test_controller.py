"""The file of a champion: what is refused when it is loaded."""

from pathlib import Path

import msgspec
import pytest

from tests.robots.controllers import controller
from zswarm.champion.controller import MOST, load_controller
from zswarm.errors import ConfigError


@pytest.mark.parametrize("size", [0, -1, MOST + 1, 10**9])
@pytest.mark.parametrize("which", ["inputs", "outputs"])
def test_absurd_sizes_are_refused_before_anything_is_allocated(
    which: str, size: int, tmp_path: Path
) -> None:
    changed = msgspec.structs.replace(controller("fully-meshed"), **{which: size})
    (tmp_path / "champion.zsc").write_bytes(msgspec.msgpack.encode(changed))
    with pytest.raises(ConfigError, match=f"damaged, or no controller: .*{which}"):
        load_controller(tmp_path)
