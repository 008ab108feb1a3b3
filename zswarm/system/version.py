"""The version of zswarm."""

VERSION = "0.1.0"
