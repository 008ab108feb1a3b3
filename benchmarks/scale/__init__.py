"""How zswarm scales: many servers that are true to the protocol, one optimizer, on one machine."""

import os

os.environ["ZSWARM_PLAIN"] = "1"  # nothing here is compiled
