"""Profiles of robots: their topics, frames and limits."""
