"""Ask a server for its offer, again and again, and take no answer.

python -m tests.attacks.deaf ENDPOINT SERVER; prints how often it asked. Zenoh takes no further
answer while a callback runs.
"""

import itertools
import json
import sys
import time

import zenoh

from zswarm.protocol import codec, keys, messages

HEARD = 100  # answers that it takes
CONFIG = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}}


def main(at: str, server: str) -> None:
    """Ask until this process is killed."""
    config = CONFIG | {"connect": {"endpoints": [at]}}
    opened = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    heard = itertools.count()

    def on_reply(_reply: zenoh.Reply) -> None:
        if next(heard) >= HEARD:
            time.sleep(3600)

    body = codec.encode(messages.Requirements())
    for number in itertools.count(1):
        opened.get(
            keys.offer("default", server),
            zenoh.handlers.Callback(on_reply, indirect=False),
            payload=body,
            timeout=60.0,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        if number % 100 == 0:
            print(number, flush=True)
            time.sleep(0.05)


if __name__ == "__main__":
    main(*sys.argv[1:])
