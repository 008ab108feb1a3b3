"""A server's numbers for Prometheus, on a port of this machine. It needs the package prometheus-client (extra ``metrics``)."""

import threading
from collections.abc import Iterator
from socketserver import TCPServer, ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from zswarm import extras
from zswarm.errors import ConfigError
from zswarm.ss.view import View

try:
    from prometheus_client import CollectorRegistry, make_wsgi_app
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
    from prometheus_client.registry import Collector
except ImportError as error:
    raise ConfigError(f"--metrics needs the package {error.name}: {extras.how('metrics')}") from None

ADDRESS = "127.0.0.1"
SCRAPE_S = 5.0  # a connection that is silent for longer is closed


class Metrics(Collector):
    """The port. It shows what the loop put into ``view`` last, and asks the loop nothing."""

    def __init__(self, port: int, view: View) -> None:
        """Listen.

        Raises:
            ConfigError: the port cannot be had.
        """
        self.view = view
        registry = CollectorRegistry()
        registry.register(self)
        try:
            self._server = make_server(ADDRESS, port, make_wsgi_app(registry), _Server, _Silent)
        except OSError as error:
            raise ConfigError(f"--metrics {port}: {ADDRESS}:{port} cannot be listened on: {error.strerror}") from None
        threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True).start()

    def close(self) -> None:
        """Let go of the port."""
        self._server.shutdown()
        self._server.server_close()

    def collect(self) -> Iterator[Metric]:
        """The numbers."""
        view = self.view
        yield InfoMetricFamily("zswarm_ss", "This server.", {"server": view.server, "version": view.program, "realm": view.realm})
        yield GaugeMetricFamily("zswarm_ss_start_time_seconds", "Start of this server, Unix time.", view.since)
        yield GaugeMetricFamily("zswarm_ss_warm", "Whether the slots are warm.", view.warm)
        yield GaugeMetricFamily("zswarm_ss_draining", "Whether it finishes what runs and takes nothing new.", view.draining)
        slots = GaugeMetricFamily("zswarm_ss_slots", "Slots by what they do.", labels=["state"])
        for state, count in view.slots.items():
            slots.add_metric([state], count)
        yield slots
        yield GaugeMetricFamily("zswarm_ss_slots_missed", "Slots whose process should be there and is not.", len(view.missed))
        yield GaugeMetricFamily("zswarm_ss_slot_memory_bytes", "What the process of a slot may take.", view.slot_memory_mb << 20)
        yield GaugeMetricFamily("zswarm_ss_leases", "Runs that hold slots or wait for some.", len(view.leases))
        yield CounterMetricFamily("zswarm_ss_trials", "Trials evaluated.", view.trials)
        yield CounterMetricFamily("zswarm_ss_busy_seconds", "Time that slots spent on batches, added up.", view.busy_s)
        faults = CounterMetricFamily("zswarm_ss_faults", "Slots whose process died or was killed.", labels=["kind"])
        for kind, count in view.faults.items():
            faults.add_metric([kind], count)
        yield faults
        yield CounterMetricFamily("zswarm_ss_malformed_messages", "Messages that were refused as malformed.", view.malformed)
        yield GaugeMetricFamily("zswarm_ss_waiting_batches", "Batches that wait for a slot.", view.waiting_batches)
        yield GaugeMetricFamily("zswarm_ss_waiting_queries", "Queries that wait for the server's loop.", view.waiting_queries)


class _Silent(WSGIRequestHandler):
    timeout = SCRAPE_S

    def log_message(self, *_: Any) -> None:
        """Scrapes are no news."""


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True

    def server_bind(self) -> None:
        """As it is, but without asking for the host's name, which may take long."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = ADDRESS, int(self.server_address[1])
        self.setup_environ()

    def handle_error(self, *_: Any) -> None:
        """Whoever hung up misses the answer, nobody else does."""
