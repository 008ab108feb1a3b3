"""Follow the batches that a run sends, until it is certain that no server computes them."""

from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import Answered, Ask
from zswarm.protocol import messages


class Awaited:
    """The batches that servers may have."""

    def __init__(self) -> None:
        self._leases: dict[tuple[str, int], bytes] = {}  # by server and batch
        self._batches: dict[int, tuple[str, int]] = {}  # by question

    def asked(self, ask: Ask) -> None:
        """Take a question of the run."""
        server = ask.server
        match ask.message:
            case messages.Evaluate(lease=lease, batch=batch):
                self._batches[ask.question] = server, batch
                self._leases[server, batch] = lease
            case messages.Cancel(batches=batches):
                for batch in batches:
                    self._leases.pop((server, batch), None)

    def answered(self, event: Answered) -> None:
        """Take an answer: to a batch that is evaluated, or refused."""
        final = messages.Outcomes | messages.Fault | messages.Refused
        if isinstance(event.reply, final) and event.question in self._batches:
            self._leases.pop(self._batches[event.question], None)

    def forgotten(self, dispatch: Dispatch) -> str:
        """Return which batch a server computes in vain, though it was never cancelled; "": none."""
        stranded = {
            (entry.stranded.server.id, entry.stranded.id)
            for entry in dispatch.batches.queue.entries
            if entry.stranded
        }
        for (name, batch), lease in list(self._leases.items()):
            server = dispatch.servers.by_id.get(name)
            if server is None or lease not in (server.lease, server.resumable_lease):
                del self._leases[name, batch]  # it ended with its lease
            elif (
                batch not in server.batches
                and batch not in server.unwanted
                and (name, batch) not in stranded
            ):
                return f"batch {batch} on {name} is neither awaited nor cancelled"
        return ""
