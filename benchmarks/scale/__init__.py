"""How zswarm scales: many servers that are true to the protocol, one optimizer, on one machine."""
