"""A server's numbers for Prometheus, on a port of this machine (extra ``metrics``)."""

import threading
from collections.abc import Iterator
from socketserver import TCPServer, ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from zswarm.errors import ConfigError
from zswarm.ss.local.snapshot import View
from zswarm.system import extras

try:
    from prometheus_client import CollectorRegistry, core, make_wsgi_app
    from prometheus_client.registry import Collector
except ImportError as error:
    text = f"--metrics needs the package {error.name}: {extras.how('metrics')}"
    raise ConfigError(text) from None

ADDRESS = "127.0.0.1"
SCRAPE_S = 5.0  # a connection that is silent for longer is closed


class Metrics(Collector):
    """The port. It shows the last ``view`` that the loop set, and asks the loop nothing."""

    def __init__(self, port: int, view: View) -> None:
        self.view = view
        registry = CollectorRegistry()
        registry.register(self)
        try:
            self._server = make_server(
                ADDRESS, port, make_wsgi_app(registry), _Server, _Silent
            )
        except OSError as error:
            text = f"{ADDRESS}:{port} cannot be listened on: {error.strerror}"
            raise ConfigError(f"--metrics {port}: {text}") from None
        threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        ).start()

    def close(self) -> None:
        """Close the port."""
        self._server.shutdown()
        self._server.server_close()

    def collect(self) -> Iterator[core.Metric]:
        """Yield the numbers."""
        view = self.view
        info = {"server": view.server, "version": view.program, "realm": view.realm}
        yield core.InfoMetricFamily("zswarm_ss", "This server.", info)
        gauges = {
            "start_time_seconds": (view.since, "Start of this server, Unix time."),
            "warm": (view.warm, "Whether the slots are warm."),
            "draining": (
                view.draining,
                "Whether it finishes what runs and takes nothing new.",
            ),
            "slots_missed": (len(view.missed), "Slots that have no process for long."),
            "slot_memory_bytes": (
                view.slot_memory_mb << 20,
                "Memory of a slot's process, at most.",
            ),
            "leases": (len(view.leases), "Runs that hold slots or wait for some."),
            "waiting_batches": (view.waiting_batches, "Batches that wait for a slot."),
            "waiting_queries": (
                view.waiting_queries,
                "Queries that wait for the server's loop.",
            ),
        }
        counters = {
            "trials": (view.trials, "Trials evaluated."),
            "busy_seconds": (view.busy_s, "Time that slots spent on batches, summed."),
            "malformed_messages": (
                view.malformed,
                "Messages that were refused as malformed.",
            ),
        }
        for name, (value, text) in gauges.items():
            yield core.GaugeMetricFamily(f"zswarm_ss_{name}", text, value)
        for name, (value, text) in counters.items():
            yield core.CounterMetricFamily(f"zswarm_ss_{name}", text, value)
        slots = core.GaugeMetricFamily(
            "zswarm_ss_slots", "Slots by state.", labels=["state"]
        )
        text = "Slots whose process died or was killed."
        faults = core.CounterMetricFamily("zswarm_ss_faults", text, labels=["kind"])
        for family, counts in ((slots, view.slots), (faults, view.faults)):
            for label, count in counts.items():
                family.add_metric([label], count)
            yield family


class _Silent(WSGIRequestHandler):
    timeout = SCRAPE_S

    def log_message(self, *_: Any) -> None:
        """Log no scrapes."""


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True

    def server_bind(self) -> None:
        """Bind without asking for the host's name, which may take long."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = ADDRESS, int(self.server_address[1])
        self.setup_environ()

    def handle_error(self, *_: Any) -> None:
        """Ignore a client that hung up."""
