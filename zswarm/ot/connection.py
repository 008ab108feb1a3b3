"""The servers that somebody uses: this machine's slots, which start first and load meanwhile, and how to reach the others."""

import functools
from types import TracebackType
from typing import TYPE_CHECKING, Self

from zswarm.experiment import Cluster, slots_of_this_machine
from zswarm.ot.local import LocalServer

if TYPE_CHECKING:
    from zswarm.session import Reach


class Connection:
    """Servers for any number of runs, from entering to leaving.

    Attributes:
        options: which servers.
        local: this machine's slots; None where none are asked for.
    """

    def __init__(self, options: Cluster) -> None:
        self.options = options
        self.local: LocalServer | None = None

    def __enter__(self) -> Self:
        if not isinstance(self.options.servers, int):
            self.local = LocalServer(slots_of_this_machine(self.options), self.options.realm)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self.local is not None:
            self.local.__exit__(kind, error, trace)

    @functools.cached_property
    def reach(self) -> "Reach":
        """How other machines are reached, with the keys that are installed.

        Raises:
            ConfigError: the keys cannot be used.
        """
        from zswarm.security import keyring
        from zswarm.session import Reach

        if self.options.servers == "local":
            return Reach((), multicast=False)
        return Reach(self.options.connect, self.options.multicast, self.options.through_router, keyring.installed("ot"))

    def who_computes(self) -> str:
        """For people."""
        servers, realm = self.options.servers, self.options.realm
        here = f"{self.local.slots} slot{'s' if self.local.slots != 1 else ''} of this machine" if self.local else ""
        if servers == "local":
            return here
        if servers == "auto":
            return f"{here}, and every server found in realm {realm}"
        return f"waiting for {servers} servers in realm {realm}"
