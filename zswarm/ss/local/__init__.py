"""The local view of a server: status, drain and metrics on its own machine."""
